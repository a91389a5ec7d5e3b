import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.scene.placed import Placed
from xray_drake.cell.cameras import nominal_camera
from xray_drake.scene.meshes import load_meshes
from xray_drake.scene.meshes.textures import (
    is_red,
    mean_color,
)

GREEN, BLUE = (30, 180, 40), (30, 40, 200)


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


REDS = [(200, 20, 20), (180, 40, 20), (190, 10, 60), (120, 20, 20)]


@pytest.mark.parametrize("of", ["texture", "vertices"])
@pytest.mark.parametrize(
    "color", [GREEN, BLUE, (200, 190, 190), (60, 60, 60), *REDS]
)
def test_red_becomes_another_colour_and_others_stay(tmp_path, color, of):
    """The hue of a texture is turned; colours of vertices give way."""
    wanted = np.array(color) / 255
    if of == "texture":
        model = import_box(tmp_path / "in", checkered(color, color))
        assert not is_red(mean_color(model.textured))
        assert max(model.color[:3]) == pytest.approx(wanted.max(), abs=0.02)
    else:
        ball = trimesh.creation.icosphere(2, 0.03)
        ball.visual.vertex_colors = [*color, 255]
        (tmp_path / "in").mkdir()
        ball.export(tmp_path / "in" / "ball.ply")
        (model,) = load_meshes(tmp_path / "in")
        assert model.textured is None
    assert is_red(wanted) == (color in REDS)
    assert not is_red(np.array(model.color[:3]))
    same = np.allclose(model.color[:3], wanted, atol=0.01)
    assert same == (color not in REDS)


def test_drake_renders_the_texture(tmp_path):
    model = import_box(tmp_path / "in", checkered(GREEN, BLUE))
    poses = {model.name: (0, 0, 0.5)}
    camera = nominal_camera()
    placed = Placed([model], poses, camera=camera, textured=True)
    image = placed.image("color").astype(int)
    green = image[..., 1] > image[..., 2] + 40
    blue = image[..., 2] > image[..., 1] + 40
    assert green.sum() > 200
    assert blue.sum() > 200
    # The texture's left half lies at negative x.
    assert green[:, : image.shape[1] // 2].sum() > 0.9 * green.sum()
