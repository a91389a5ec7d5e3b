"""Cameras as others write them down.

Drake's ``CameraConfig`` in YAML, ROS's ``CameraInfo`` (camera_calibration's
YAML, or a message as ``ros2 topic echo`` prints it), autolab_core's ``.intr``,
and the bare 3×3 matrix in a text file. All but Drake's put pixel centres at
integers.
"""

import json
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.sensors import CameraConfig

from xray_drake.cell.cameras import PIXEL_CENTER, sized
from xray_drake.cell.drake_rules import DRAKE_RULES
from xray_drake.configuration import (
    build_struct,
    check,
    check_tree,
    fields_of,
)
from xray_drake.trees import ConfigurationError, read_text, read_tree

_AUTOLAB = ("_fx", "_fy", "_cx", "_cy", "_width", "_height")
_SIZES = (("image_width", "image_height"), ("width", "height"))
_PROJECTIONS = ("projection_matrix", "P", "p")
_MATRICES = ("camera_matrix", "K", "k")
_DISTORTIONS = ("distortion_coefficients", "D", "d")


def read_camera(path: Path, usual: CameraConfig) -> CameraConfig:
    """Reads a camera.

    Args:
        path: of a file in one of the formats above.
        usual: gives all that the file does not: pose and sensor's range, and
            the size where it is a bare matrix.

    Returns:
        A config of its own.

    Raises:
        ConfigurationError: the file cannot be read, is none of these, or says
            what cannot be; one line.
    """
    text = read_text(path)
    numbers = _table(text)
    if numbers is not None:
        return _of_matrix(numbers, None, usual, str(path))
    try:
        tree: Any = json.loads(text)
    except ValueError:
        tree = read_tree(text.split("\n---")[0], str(path))
    if not isinstance(tree, dict):
        raise ConfigurationError(f"{path} holds no camera")
    if "_fx" in tree:
        return _of_autolab(tree, usual, str(path))
    if any(key in tree for key in (*_MATRICES, *_PROJECTIONS)):
        return _of_ros(tree, usual, str(path))
    if set(tree) & set(fields_of(CameraConfig)):
        tree = sized(tree, usual)
        check_tree(tree, CameraConfig, str(path), DRAKE_RULES)
        config = build_struct(CameraConfig, tree, str(path), usual)
        check(config, str(path), DRAKE_RULES)
        return config
    raise ConfigurationError(
        f"{path} is no camera that is known: give Drake's CameraConfig, a "
        "CameraInfo of ROS, an .intr of autolab_core, or a text file of the "
        "3×3 matrix"
    )


def _table(text: str) -> np.ndarray | None:
    """Returns the numbers of a text file that holds nothing else."""
    rows = [
        line.replace(",", " ").split()
        for line in text.splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    try:
        numbers = np.array([[float(word) for word in row] for row in rows])
    except ValueError:
        return None
    return numbers if numbers.ndim == 2 else None


def _of_autolab(
    tree: Mapping[str, Any], usual: CameraConfig, source: str
) -> CameraConfig:
    missing = [key for key in _AUTOLAB if key not in tree]
    if missing:
        raise ConfigurationError(f"{source}: {missing[0]} is missing")
    fx, fy, cx, cy, width, height = (tree[key] for key in _AUTOLAB)
    K = [[fx, tree.get("_skew", 0.0), cx], [0, fy, cy], [0, 0, 1]]
    return _of_matrix(K, (width, height), usual, source)


def _of_ros(
    tree: Mapping[str, Any], usual: CameraConfig, source: str
) -> CameraConfig:
    """The rectified image's camera, where there is one."""
    size = next(
        (
            tuple(tree[key] for key in keys)
            for keys in _SIZES
            if all(key in tree for key in keys)
        ),
        None,
    )
    if size is None:
        raise ConfigurationError(
            f"{source}: the size of the images is missing (image_width and "
            "image_height, or width and height)"
        )
    projection = _numbers_at(tree, _PROJECTIONS)
    if projection is not None and np.size(projection) == 12:
        return _of_matrix(
            np.reshape(projection, (3, 4))[:, :3], size, usual, source
        )
    distortion = _numbers_at(tree, _DISTORTIONS)
    if distortion is not None and np.any(distortion):
        raise ConfigurationError(
            f"{source}: the image is distorted, and no projection_matrix (P) "
            "says what it is when rectified: rectify it first"
        )
    matrix = _numbers_at(tree, _MATRICES)
    if matrix is None or np.size(matrix) != 9:
        raise ConfigurationError(
            f"{source}: the camera matrix is missing, or has no 9 numbers"
        )
    return _of_matrix(np.reshape(matrix, (3, 3)), size, usual, source)


def _numbers_at(
    tree: Mapping[str, Any], keys: tuple[str, ...]
) -> np.ndarray | None:
    """Returns the numbers of the first of some keys that a tree has."""
    for key in keys:
        value = tree.get(key)
        if isinstance(value, dict):
            value = value.get("data")
        if value is not None:
            try:
                return np.array(value, dtype=float)
            except (TypeError, ValueError):
                return np.zeros(0)
    return None


def _of_matrix(
    K: Any, size: Any, usual: CameraConfig, source: str
) -> CameraConfig:
    try:
        K = np.array(K, dtype=float)
        width, height = map(int, size or (usual.width, usual.height))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{source}: {error}") from error
    fine = K.shape == (3, 3) and np.isfinite(K).all() and K[0, 0] > 0
    if not (fine and K[1, 1] > 0 and np.allclose(K[2], [0, 0, 1])):
        raise ConfigurationError(
            f"{source}: {K.tolist()} is no camera matrix: that is 3×3, with "
            "focal lengths above 0 and a last row of 0 0 1"
        )
    if abs(K[0, 1]) > 1e-6 * K[0, 0]:
        raise ConfigurationError(
            f"{source}: the camera has a skew of {K[0, 1]:g}: only square and "
            "rectangular pixels are supported"
        )
    center = K[:2, 2]
    if (
        size is None
        and (np.abs(2 * center / (width, height) - 1) > _OFF_CENTER).any()
    ):
        raise ConfigurationError(
            f"{source} does not say how large the images are, and its centre, "
            f"({center[0]:g}, {center[1]:g}), is not near the middle of the "
            f"cell's {width} × {height}: give the size in the cell (overhead: "
            "{width: …, height: …})"
        )
    config = deepcopy(usual)
    config.width, config.height = width, height
    config.focal = CameraConfig.FocalLength(x=K[0, 0], y=K[1, 1])
    config.center_x, config.center_y = (center + PIXEL_CENTER).tolist()
    check(config, source, DRAKE_RULES)
    return config


_OFF_CENTER = 0.15
"""A centre is near the middle within this share of half the image."""
