import socket

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from tests.meshcat_probe import pose, prop, shown, vertices
from xray_drake.drawing.colors import heat
from xray_drake.drawing.meshcat_layers import (
    draw_grasp,
    draw_masks,
    draw_occupancy,
    draw_outline,
    draw_text,
    look_at_bin,
    set_layer_opacity,
    start_meshcat,
)
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import Grasp, GraspKind


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return start_meshcat()


@pytest.fixture
def camera() -> PinholeCamera:
    X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WC[2, 3] = 0.8
    K = np.array([[50.0, 0, 15.5], [0, 50.0, 11.5], [0, 0, 1]])
    return PinholeCamera(32, 24, K, X_WC)


def test_meshcat_answers_to_this_machine_alone() -> None:
    meshcat = start_meshcat()
    with socket.create_connection(("127.0.0.1", meshcat.port()), 5):
        pass
    # A server on every interface would answer at all of 127.0.0.0/8.
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.2", meshcat.port()), 5)


def test_a_port_that_is_taken_is_an_error() -> None:
    first = start_meshcat()
    with pytest.raises(RuntimeError, match="port"):
        start_meshcat(first.port())


def test_the_camera_looks_into_the_bin(meshcat: Meshcat) -> None:
    look_at_bin(meshcat)
    assert prop(meshcat, "/Grid", "visible") is False
    assert prop(meshcat, "/Axes", "visible") is False
    # The camera's node turns y up (three.js) to z up.
    x, y, z = prop(meshcat, "/Cameras/default/rotated/<object>", "position")
    assert y > 0.3, "above the bin"
    assert np.hypot(x, z) < 1.2, "near it"
    look_at_bin(meshcat, from_afar=True)
    farther = prop(meshcat, "/Cameras/default/rotated/<object>", "position")
    assert np.linalg.norm(farther) > 1.3 * np.linalg.norm([x, y, z])


def test_occupancy_lies_on_the_heap(
    meshcat: Meshcat, camera: PinholeCamera
) -> None:
    depth = camera.plane_depth(0.0).astype(np.float32)
    depth[9:12, 14:18] -= 0.1
    depth[10, 16] = 0
    values = np.zeros(camera.shape)
    values[4:16, 10:24] = 0.5
    draw_occupancy(meshcat, "/t/occupancy", values, depth, camera, opacity=0.3)
    drawn = vertices(meshcat, "/t/occupancy")
    u, v, _ = camera.project(drawn).T
    assert (u.min(), u.max()) == pytest.approx((10, 22), abs=0.01)
    assert (v.min(), v.max()) == pytest.approx((4, 14), abs=0.01)
    assert drawn[:, 2].min() == pytest.approx(0.0, abs=0.01)
    assert drawn[:, 2].max() == pytest.approx(0.1, abs=0.01)
    # It does not tear where there is no reading.
    on_block = (abs(u - 15) < 2) & (abs(v - 10) < 1)
    assert drawn[on_block, 2].min() == pytest.approx(0.1, abs=0.01)
    # Linear light: the colours on the screen are those of the colour map.
    (geometry,) = shown(meshcat, "/t/occupancy")["geometries"]
    colors = geometry["data"]["attributes"]["color"]["array"]
    linear = np.frombuffer(colors.data, np.float32).reshape(-1, 3)
    np.testing.assert_allclose(linear[0], heat(0.5) ** 2.2, atol=1e-6)
    opacity = prop(meshcat, "/t/occupancy/<object>", "modulated_opacity")
    assert opacity == 0.3


def test_blank_layers_replace_what_was_drawn(
    meshcat: Meshcat, camera: PinholeCamera
) -> None:
    depth = camera.plane_depth(0.0).astype(np.float32)
    mask = np.zeros(camera.shape, bool)
    mask[5:15, 5:20] = True
    grasp = Grasp(GraspKind.SUCTION, "cup")

    def draw(mask: np.ndarray, grasp: Grasp) -> list[bool]:
        draw_occupancy(meshcat, "/b/occupancy", 1.0 * mask, depth, camera)
        draw_outline(meshcat, "/b/outline", mask, depth, camera)
        draw_grasp(meshcat, "/b/grasp", grasp)
        return [
            meshcat.HasPath(f"/b/{layer}")
            for layer in ("occupancy", "outline", "grasp")
        ]

    assert draw(mask, grasp) == [True] * 3
    assert draw(~mask & mask, Grasp()) == [False] * 3


def test_the_outline_runs_along_the_edge_of_the_mask(
    meshcat: Meshcat, camera: PinholeCamera
) -> None:
    depth = camera.plane_depth(0.05).astype(np.float32)
    mask = np.zeros(camera.shape, bool)
    mask[5:18, 6:25] = True
    draw_outline(meshcat, "/o/outline", mask, depth, camera)
    points = vertices(meshcat, "/o/outline")
    u, v, _ = camera.project(points).T
    assert {u.min().round(), u.max().round()} == {5, 25}
    assert {v.min().round(), v.max().round()} == {4, 18}
    assert not ((u > 7.5) & (u < 22.5) & (v > 6.5) & (v < 15.5)).any()
    draw_outline(
        meshcat, "/o/wide", mask, depth, camera, color=(0, 0, 1.0), width=2
    )
    assert len(vertices(meshcat, "/o/wide")) > len(points)
    colors = [
        shown(meshcat, f"/o/{name}")["materials"][0]["color"]
        for name in ("outline", "wide")
    ]
    assert colors[0] != colors[1] == 0x0000FF
    # Over the layer of colours, which would flicker at the same height.
    draw_occupancy(meshcat, "/o/occupancy", 1.0 * mask, depth, camera)
    layer = vertices(meshcat, "/o/occupancy")
    assert points[:, 2].min() > layer[:, 2].max() + 0.001


def some_pose() -> np.ndarray:
    X_WG = np.eye(4)
    X_WG[:3, :3] = Rotation.from_euler("xyz", [2.5, 0.4, 1.0]).as_matrix()
    X_WG[:3, 3] = 0.05, -0.02, 0.07
    return X_WG


def rods(meshcat: Meshcat, path: str, X_WG: np.ndarray) -> np.ndarray:
    """Returns (n, 2, 3): ends of the rods at a path, in the grasp frame."""
    ends = []
    while meshcat.HasPath(rod := f"{path}/rod_{len(ends)}"):
        (geometry,) = shown(meshcat, rod)["geometries"]
        assert geometry["type"] == "CapsuleGeometry"
        X = pose(meshcat, rod)
        half = geometry["height"] / 2 * X[:3, 2]
        p_W = np.array([X[:3, 3] - half, X[:3, 3] + half])
        ends.append((p_W - X_WG[:3, 3]) @ X_WG[:3, :3])
    return np.array(ends)


def test_a_suction_grasp_is_a_cup_at_its_pose(meshcat: Meshcat) -> None:
    X_WG = some_pose()
    draw_grasp(meshcat, "/s", Grasp(GraspKind.SUCTION, "block", X_WG))
    np.testing.assert_allclose(pose(meshcat, "/s/cup"), X_WG, atol=1e-9)
    (cup,) = shown(meshcat, "/s/cup")["geometries"]
    assert cup["radiusTop"] == cup["radiusBottom"] == 0.015
    # The stem stands on the cup, against the approach.
    (stem,) = rods(meshcat, "/s", X_WG)
    np.testing.assert_allclose(stem, [[0, 0, -0.06], [0, 0, 0]], atol=1e-6)


def test_a_jaw_grasp_is_a_fork_as_wide_as_the_grasp(meshcat: Meshcat) -> None:
    X_WG = some_pose()
    draw_grasp(meshcat, "/j", Grasp(GraspKind.SUCTION, "block", X_WG))
    draw_grasp(meshcat, "/j", Grasp(GraspKind.JAW, "block", X_WG, width=0.03))
    assert not meshcat.HasPath("/j/cup")
    left, bridge, right = rods(meshcat, "/j", X_WG)
    # Tips between which the object is, and a bridge behind them.
    np.testing.assert_allclose(left[0], [0, -0.015, 0], atol=1e-6)
    np.testing.assert_allclose(right[1], [0, 0.015, 0], atol=1e-6)
    np.testing.assert_allclose(left[1], bridge[0], atol=1e-6)
    np.testing.assert_allclose(right[0], bridge[1], atol=1e-6)
    np.testing.assert_allclose(bridge[:, 2], -0.06, atol=1e-6)


def test_masks_are_translucent(meshcat: Meshcat, camera: PinholeCamera) -> None:
    labels = np.full(camera.shape, -1)
    labels[4:12, 4:20] = 0
    depth = np.full(camera.shape, 0.7)
    path = "/masks"
    draw_masks(meshcat, path, labels, np.ones((1, 3)), depth, camera)
    assert prop(meshcat, f"{path}/<object>", "modulated_opacity") == 0.8
    points = vertices(meshcat, path)
    np.testing.assert_allclose(points[:, 2], 0.1015, atol=1e-6)
    set_layer_opacity(meshcat, path, 0.25)
    assert prop(meshcat, f"{path}/<object>", "modulated_opacity") == 0.25
    blank = np.full(camera.shape, -1)
    draw_masks(meshcat, path, blank, np.ones((1, 3)), depth, camera)
    assert not meshcat.HasPath(path)


def test_text_stands_where_it_is_put(meshcat: Meshcat) -> None:
    X_WT = RigidTransform([0.1, 0.2, 0.3])
    color = (0.0, 0.0, 0.0)
    draw_text(meshcat, "/text", ("seed 7",), X_WT, height=0.02, color=color)
    np.testing.assert_allclose(pose(meshcat, "/text")[:3, 3], [0.1, 0.2, 0.3])
    points = vertices(meshcat, "/text")
    assert 0 < points[:, 1].min() < points[:, 1].max() < 0.02
    draw_text(meshcat, "/text", ("",), X_WT, height=0.02, color=color)
    assert not meshcat.HasPath("/text")
