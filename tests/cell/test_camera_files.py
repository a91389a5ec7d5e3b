from pathlib import Path

import numpy as np
import pytest

from xray_drake.cell.camera_files import read_camera
from xray_drake.cell.cameras import nominal_camera, pinhole_camera
from xray_drake.trees import ConfigurationError

K = np.array([[610.0, 0, 322.5], [0, 612.0, 238.25], [0, 0, 1]])
DATA = K.ravel().tolist()
P = np.c_[K, np.zeros(3)].ravel().tolist()
SIZE = "image_width: 640\nimage_height: 480\n"


@pytest.mark.parametrize(
    "text",
    [
        '{"_fx": 610, "_fy": 612, "_cx": 322.5, "_cy": 238.25, "_skew": 0.0, '
        '"_width": 640, "_height": 480, "_frame": "phoxi"}',
        f"{SIZE}camera_matrix: {{rows: 3, cols: 3, data: {DATA}}}\n"
        "distortion_coefficients: {data: [0, 0, 0, 0, 0]}\n",
        f"{SIZE}camera_matrix: {{data: {(2 * K).ravel().tolist()}}}\n"
        "distortion_coefficients: {data: [0.1, 0, 0, 0, 0]}\n"
        f"projection_matrix: {{data: {P}}}\n",
        f"header: {{stamp: 3}}\nheight: 480\nwidth: 640\nd: []\nk: {DATA}\n"
        "---\n",
        "width: 640\nheight: 480\nfocal: {x: 610, y: 612}\n"
        "center_x: 323.0\ncenter_y: 238.75\n",
    ],
    ids=["autolab", "ros", "ros rectified", "ros message", "drake"],
)
def test_formats(text: str, tmp_path: Path) -> None:
    path = tmp_path / "camera"
    path.write_text(text)
    usual = nominal_camera()
    config = read_camera(path, usual)
    camera = pinhole_camera(config)
    assert camera.shape == (480, 640)
    np.testing.assert_allclose(camera.intrinsics, K, atol=1e-9)
    # All else is that of the cell, which stays as it is.
    np.testing.assert_array_equal(camera.X_WC, pinhole_camera(usual).X_WC)
    assert (config.z_far, usual.width) == (usual.z_far, 512)


def test_a_bare_matrix_has_the_cells_size(tmp_path: Path) -> None:
    path = tmp_path / "K.txt"
    np.savetxt(path, [[600, 0, 256], [0, 600, 190], [0, 0, 1]], header="K")
    camera = pinhole_camera(read_camera(path, nominal_camera()))
    assert camera.shape == (384, 512)
    assert camera.intrinsics[0].tolist() == [600, 0, 256]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no camera that is known"),
        ("a: 1", "no camera that is known"),
        ("[1, 2]", "holds no camera"),
        ("1 2\n3 4", "is no camera matrix"),
        ("600 0 100\n0 600 190\n0 0 1", "does not say how large the images"),
        ("600 9 256\n0 600 190\n0 0 1", "skew"),
        ("-1 0 256\n0 600 190\n0 0 1", "is no camera matrix"),
        ("nan 0 256\n0 600 190\n0 0 1", "is no camera matrix"),
        ('{"_fx": 610, "_fy": 612}', "_cx is missing"),
        (f"K: {DATA}", "the size of the images is missing"),
        (f"{SIZE}K: [1, 2]", "has no 9 numbers"),
        (f"{SIZE}K: {DATA}\nD: [0.1]", "rectify it first"),
        (f"width: -5\nheight: 480\nK: {DATA}", "width is -5"),
        ("width: 640\nfocal: {x: -1}", "focal.x is -1"),
        ("width: [", "is not YAML"),
    ],
)
def test_what_is_no_camera(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as error:
        read_camera(path, nominal_camera())
    assert said in str(error.value) and str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot read"):
        read_camera(tmp_path / "none.yaml", nominal_camera())
