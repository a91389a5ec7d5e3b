import subprocess
import sys

import numpy as np
import pytest
from pydrake.common.schema import Rotation
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig

from tests.scene.placed import Placed
from xray_drake.cell.cameras import (
    CameraSampling,
    nominal_camera,
    pinhole_camera,
    sample_camera,
)
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.scene.cameras import add_camera, add_renderer
from xray_drake.scene.plant import add_object, add_plant, default_plant_config
from xray_drake.scene.targets import target_model

LID = target_model("lid")


def tilted_camera() -> CameraConfig:
    """A camera from the side, rolled, with other intrinsics."""
    config = nominal_camera()
    config.width, config.height = 320, 240
    config.focal = CameraConfig.FocalLength(x=300.0, y=320.0)
    config.center_x, config.center_y = 155.0, 122.0
    config.X_PB.translation = [0.15, -0.1, 0.7]
    config.X_PB.rotation = Rotation(value=Rotation.Rpy(deg=[172.0, 11.0, 25.0]))
    return config


class Scene(Placed):
    """A bin with a lid in it, and a camera."""

    def __init__(self, config: CameraConfig, *p_WL: float) -> None:
        super().__init__([LID], {"lid": p_WL}, camera=config)


def centroid(mask: np.ndarray) -> np.ndarray:
    """Returns (u, v)."""
    return np.argwhere(mask).mean(axis=0)[::-1]


@pytest.fixture(scope="module")
def nominal() -> Scene:
    return Scene(nominal_camera(), 0.0805, 0.0505, 0.005)


@pytest.fixture(scope="module")
def tilted() -> Scene:
    return Scene(tilted_camera(), 0.03, 0.02, 0.02)


def test_the_nominal_camera_is_the_protocols() -> None:
    config = nominal_camera()
    assert (config.center_x, config.center_y) == (255.5, 191.5)
    camera = pinhole_camera(config)
    assert camera.shape == (384, 512)
    # Drake counts from the image's edge, PinholeCamera from a pixel's centre.
    np.testing.assert_allclose(
        camera.intrinsics, [[552.5, 0, 255.0], [0, 552.5, 191.0], [0, 0, 1]]
    )
    np.testing.assert_allclose(
        camera.X_WC,
        [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]],
        atol=1e-12,
    )


def test_the_walls_are_seen_at_their_height(nominal: Scene) -> None:
    depth = nominal.image("depth")
    assert depth.shape == (384, 512)
    assert depth.dtype == np.float32
    assert 0.8 - 0.121 < depth.min() < 0.8 - 0.119


@pytest.mark.parametrize("name", ["nominal", "tilted"])
def test_the_model_of_the_camera_fits_its_images(
    name: str, request: pytest.FixtureRequest
) -> None:
    """A shift by half a pixel shows: it changes 3 to 6 % of the mask."""
    scene: Scene = request.getfixturevalue(name)
    expected = project_mesh_mask(
        LID.visual.vertices,
        LID.visual.faces,
        scene.pose("lid"),
        scene.camera,
    )
    mask = scene.mask("lid")
    assert mask.sum() > 300
    assert np.count_nonzero(mask != expected) < 0.015 * mask.sum()
    np.testing.assert_allclose(centroid(mask), centroid(expected), atol=0.1)


@pytest.mark.parametrize("name", ["nominal", "tilted"])
def test_depth_lies_on_the_floor_in_every_pixel(
    name: str, request: pytest.FixtureRequest
) -> None:
    scene: Scene = request.getfixturevalue(name)
    depth, camera = scene.image("depth"), scene.camera
    p_W = camera.unproject(np.nan_to_num(depth, posinf=0.0))
    inside = (
        np.isfinite(depth)
        & (np.abs(p_W[..., 0]) < 0.24)
        & (np.abs(p_W[..., 1]) < 0.19)
    )
    floor = inside & ~scene.mask("lid")
    # Shadows of walls have no floor; they are few.
    on_floor = np.abs(p_W[..., 2]) < 1e-5
    assert on_floor[floor].mean() > 0.99
    np.testing.assert_allclose(
        depth[floor & on_floor],
        camera.plane_depth(0.0)[floor & on_floor],
        atol=1e-5,
    )


def test_colours_are_the_models(nominal: Scene) -> None:
    red, green, blue, _ = nominal.image("color")[nominal.mask("lid")].mean(
        axis=0
    )
    assert red > 2 * max(green, blue)


def test_the_background_is_far_and_has_the_colour_asked_for() -> None:
    config = nominal_camera()
    config.X_PB.translation = [-0.45, 0.0, 0.8]  # beyond the bin
    scene = Scene(config, 0.1, 0.0, 0.005)
    beyond = np.s_[:, :212]
    assert np.isinf(scene.image("depth")[beyond]).all()
    background = scene.image("color")[beyond][..., :3].reshape(-1, 3)
    expected = np.broadcast_to([63.75, 68.85, 76.5], background.shape)
    np.testing.assert_allclose(background, expected, atol=1.5)


def test_cameras_that_cannot_be_had() -> None:
    config = nominal_camera()
    config.X_PB.base_frame = "wrist"
    with pytest.raises(ValueError, match="'overhead' is fixed to 'wrist'"):
        pinhole_camera(config)
    config.renderer_class = "RenderEngineGl"  # needs a display
    _, scene_graph = add_plant(DiagramBuilder(), default_plant_config())
    with pytest.raises(ValueError, match="'RenderEngineGl'"):
        add_renderer(scene_graph, config)


def test_two_cameras_share_a_renderer() -> None:
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, default_plant_config())
    add_object(plant, LID)
    plant.Finalize()
    first, second = nominal_camera(), tilted_camera()
    second.name = "side"
    widths = []
    for config in (first, second):
        _, source = add_camera(builder, scene_graph, config)
        camera = source.get_output_port().Eval(source.CreateDefaultContext())
        widths.append(camera.width)
    assert widths == [512, 320]
    assert scene_graph.RendererCount() == 1


def test_drawn_cameras_keep_to_their_ranges() -> None:
    """PROTOCOL.md, "Scene": radius, angle, roll, focal length, centre."""
    nominal, sampling = nominal_camera(), CameraSampling(enabled=True)
    rng = np.random.default_rng(0)
    cameras = [
        pinhole_camera(sample_camera(nominal, sampling, rng))
        for _ in range(200)
    ]
    p_WC = np.array([c.X_WC[:3, 3] for c in cameras])
    radius = np.linalg.norm(p_WC, axis=1)
    x = np.array([c.X_WC[:2, 0] for c in cameras])
    K = np.array([c.intrinsics for c in cameras])
    shift = K[:, :2, 2] - pinhole_camera(nominal).intrinsics[:2, 2]
    for values, least, most in (
        (radius, (0.7, 0.72), (0.88, 0.9)),
        (np.rad2deg(np.arccos(p_WC[:, 2] / radius)), (0, 1), (9, 10)),
        # The tilt turns x a little.
        (np.rad2deg(np.arctan2(*x.T[::-1])), (-10.5, -9), (9, 10.5)),
        (K[:, 0, 0], (535, 537), (558, 560)),
        (shift, (-3, -2.9), (2.9, 3)),
    ):
        assert least[0] <= values.min() < least[1]
        assert most[0] < values.max() <= most[1]
    np.testing.assert_array_equal(K[:, 0, 0], K[:, 1, 1])
    for camera in cameras:  # It looks at the middle of the floor.
        seen = camera.project(np.zeros(3))[:2]
        np.testing.assert_allclose(seen, camera.intrinsics[:2, 2], atol=1e-9)


def test_without_sampling_the_nominal_camera_is_used() -> None:
    nominal = nominal_camera()
    camera = sample_camera(nominal, CameraSampling(), np.random.default_rng(0))
    assert camera is not nominal
    one, other = pinhole_camera(camera), pinhole_camera(nominal)
    np.testing.assert_array_equal(one.X_WC, other.X_WC)
    np.testing.assert_array_equal(one.intrinsics, other.intrinsics)


_RENDER_THEN_IMPORT = """
from pydrake.systems.framework import DiagramBuilder
from xray_drake.scene.cameras import add_camera
from xray_drake.cell.cameras import nominal_camera
from xray_drake.scene.plant import add_plant, default_plant_config
builder = DiagramBuilder()
plant, scene_graph = add_plant(builder, default_plant_config())
plant.Finalize()
sensor, _ = add_camera(builder, scene_graph, nominal_camera())
context = builder.Build().CreateDefaultContext()
sensor.depth_image_32F_output_port().Eval(sensor.GetMyContextFromRoot(context))
import triton
"""


def test_triton_can_be_imported_after_rendering() -> None:
    pytest.importorskip("triton", reason="torch without CUDA has none")
    subprocess.run([sys.executable, "-c", _RENDER_THEN_IMPORT], check=True)
