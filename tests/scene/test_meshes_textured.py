import numpy as np
import pytest
import trimesh
from PIL import Image
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    GeometryInstance,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.sensors import CameraInfo

from xray_drake.scene.meshes import import_meshes, load_meshes
from xray_drake.scene.meshes.textures import (
    drake_mesh,
    hue_shifted,
    is_red,
    mean_color,
)

GREEN, BLUE = (30, 180, 40), (30, 40, 200)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XRAY_DRAKE_CACHE", str(tmp_path / "cache"))


def checkered(left, right, size=64):
    image = np.empty((size, size, 3), np.uint8)
    image[:, : size // 2], image[:, size // 2 :] = left, right
    return image


def textured_box(image):
    box = trimesh.creation.box((0.08, 0.06, 0.04))
    box.unmerge_vertices()
    uv = box.vertices[:, :2] / [0.08, 0.06] + 0.5
    material = trimesh.visual.material.SimpleMaterial(
        image=Image.fromarray(image)
    )
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return box


def import_box(folder, image, suffix="obj"):
    path = folder / "box" / f"textured.{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    textured_box(image).export(path)
    (model,) = load_meshes(folder)
    return model


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_textures_are_kept(tmp_path, suffix):
    model = import_box(tmp_path / "in", checkered(GREEN, BLUE), suffix)
    assert model.name == "in/box"
    texture = model.textured
    assert texture.image.shape == (64, 64, 3)
    mean = (np.array(GREEN) + BLUE) / 2 / 255
    np.testing.assert_allclose(mean_color(texture), mean, atol=0.05)
    np.testing.assert_allclose(model.color[:3], mean, atol=0.05)
    np.testing.assert_allclose(
        np.ptp(texture.vertices, axis=0), model.extents, atol=1e-6
    )
    assert len(texture.uv) == len(texture.vertices)


def test_a_change_of_the_texture_counts(tmp_path):
    import_box(tmp_path / "in", checkered(GREEN, BLUE))
    model = import_box(tmp_path / "in", checkered(BLUE, BLUE))
    np.testing.assert_allclose(model.color[:3], np.array(BLUE) / 255, atol=0.02)


def test_large_textures_shrink(tmp_path):
    model = import_box(tmp_path / "in", checkered(GREEN, BLUE, 2048))
    assert model.textured.image.shape == (512, 512, 3)


@pytest.mark.parametrize(
    "red", [(200, 20, 20), (180, 40, 20), (190, 10, 60), (120, 20, 20)]
)
def test_red_textures_change_their_hue(tmp_path, red):
    model = import_box(tmp_path / "in", checkered(red, red))
    assert is_red(np.array(red) / 255)
    assert not is_red(mean_color(model.textured))
    assert not is_red(np.array(model.color[:3]))
    value = max(red) / 255
    assert max(model.color[:3]) == pytest.approx(value, abs=0.02)


@pytest.mark.parametrize("color", [GREEN, BLUE, (200, 190, 190), (60, 60, 60)])
def test_other_colours_stay(tmp_path, color):
    model = import_box(tmp_path / "in", checkered(color, color))
    np.testing.assert_allclose(
        model.color[:3], np.array(color) / 255, atol=0.01
    )


def test_hue_shifts_turn_the_circle():
    image = np.array([[[200, 20, 20]]], np.uint8)
    np.testing.assert_array_equal(hue_shifted(image, 120), [[[20, 200, 20]]])
    np.testing.assert_array_equal(hue_shifted(image, 360), image)


@pytest.mark.parametrize(
    ("color", "kept"), [(BLUE, True), ((220, 0, 0), False)]
)
def test_vertex_colours_give_a_colour(tmp_path, color, kept):
    ball = trimesh.creation.icosphere(2, 0.03)
    ball.visual.vertex_colors = [*color, 255]
    (tmp_path / "in").mkdir()
    ball.export(tmp_path / "in" / "ball.ply")
    (model,) = import_meshes(tmp_path / "in").models
    assert model.textured is None
    assert not is_red(np.array(model.color[:3]))
    same = np.allclose(model.color[:3], np.array(color) / 255, atol=0.01)
    assert same == kept


def test_drake_renders_the_texture(tmp_path):
    model = import_box(tmp_path / "in", checkered(GREEN, BLUE))
    image = render(drake_mesh(model.textured, model.name))
    on = image.reshape(-1, 3)[image.reshape(-1, 3).min(axis=1) < 200]
    green = (on[:, 1] > on[:, 2] + 40).sum()
    blue = (on[:, 2] > on[:, 1] + 40).sum()
    assert green > 200
    assert blue > 200
    left = image[:, : image.shape[1] // 2].reshape(-1, 3).astype(int)
    assert (left[:, 1] > left[:, 2] + 40).sum() > 0.9 * green


def render(mesh):
    scene_graph = SceneGraph()
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    source = scene_graph.RegisterSource("source")
    geometry = GeometryInstance(RigidTransform(), Mesh(mesh), "box")
    properties = PerceptionProperties()
    properties.AddProperty("label", "id", RenderLabel(1))
    geometry.set_perception_properties(properties)
    scene_graph.RegisterAnchoredGeometry(source, geometry)
    context = scene_graph.CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(context)
    core = RenderCameraCore(
        "vtk",
        CameraInfo(160, 120, 0.6),
        ClippingRange(0.01, 2),
        RigidTransform(),
    )
    X_WC = RigidTransform(RollPitchYaw(np.pi, 0, 0), [0, 0, 0.25])
    image = query.RenderColorImage(
        camera=ColorRenderCamera(core),
        parent_frame=scene_graph.world_frame_id(),
        X_PC=X_WC,
    )
    return np.array(image.data)[..., :3]
