"""Instances from depth alone, of no class in particular.

After locally convex connected patches (Stein et al., "Object partitioning using
local convexity", 2014): surfaces that meet in a convex edge belong to one
object, those that meet in a concave one or are broken off in depth to two.
Where that is wrong, so is the answer: an object with concave edges of its own
falls into parts, objects whose tops are flush are one.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from xray_drake.cell.bin import Bin
from xray_drake.configuration import count, number
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import (
    check_shapes,
    depth_readings,
    has_reading,
    nearest_values,
)
from xray_drake.messages import InstanceMasks
from xray_drake.perception.concavity import concavity
from xray_drake.perception.region_graph import RegionGraph

_FINE_WEIGHT = 2.0
"""Of the concavity from pixel to pixel beside that along the arm, where it is
decided which pixel ends a region."""

_HEIGHT_STEP = 2e-5
"""Of concavities that are counted in 16 bits, m."""


@dataclass
class DepthSegmenterConfig:
    """Numbers of ``segment_depth``."""

    # What is nearer to a wall than this is the wall, m.
    wall_tolerance: float = number(0.004, "[0, 0.1]")
    # What is lower than this is the floor, m. The thinnest target is 5 mm.
    floor_height: float = number(0.0025, "[0, 0.1]")
    # Pixels without a reading take the nearest one within so many pixels.
    fill_radius: float = number(1.5, "[0, 100]")
    # Half a chord's length for the concavity, m across the view.
    arm: float = number(0.007, "(0, 0.1]")
    # A surface less concave than this has no border at all, m.
    smooth: float = number(0.001, "[0, 0.1]")
    # Regions are one where the mean concavity of their border is less, m;
    # a pixel counts at most
    join: float = number(0.004, "[0, 0.1]")
    # so many times as much.
    most: float = number(1.5, "(0, 1000]")
    # A region is the inside of another that has this share of its border.
    enclosed: float = number(0.8, "(0, 1]")
    # Smaller instances are none, pixels.
    min_area: int = count(50, "[1, 10000000]")


def segment_depth(
    depth: np.ndarray,
    camera: PinholeCamera,
    config: DepthSegmenterConfig | None = None,
    *,
    bin_: Bin | None = None,
    target: np.ndarray | None = None,
) -> InstanceMasks:
    """Finds all objects in the bin.

    Args:
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        camera: of the image.
        config: the numbers.
        bin_: in which the objects lie; by default the nominal bin.
        target: (H, W) bool, the target's modal mask; where it is not blank it
            is an instance, whatever the depth.

    Returns:
        Instances called ``segment_0``, ``segment_1``, … from the largest on.

    Raises:
        ValueError: an image that is not the camera's, or whose depths are not
            in metres.
    """
    config = config or DepthSegmenterConfig()
    if target is None:
        target = np.zeros(camera.shape, bool)
    check_shapes({"depth image": depth, "target mask": target}, camera)
    target = np.asarray(target, bool)
    filled, known = _filled(depth_readings(depth, camera), config.fill_radius)
    points = camera.unproject(filled)
    objects = known & _in_bin(points, bin_ or Bin(), config) & ~target
    labels = np.full(camera.shape, -1, np.int32)
    if objects.any():
        middle = float(np.median(filled[objects]))
        arm = max(1, round(config.arm * camera.intrinsics[0, 0] / middle))
        box = _box(objects, margin=arm + 1)
        labels[box] = _segments(
            filled[box], points[box][..., 2], objects[box], camera, arm, config
        )
    return _instances(labels, target)


def _filled(depth: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Gives each pixel the nearest reading.

    Returns:
        (H, W) float32, all above 0; (H, W) bool, whether that reading is no
        farther than ``radius`` pixels.
    """
    read = has_reading(depth)
    if not read.any():
        return np.ones(depth.shape, np.float32), read
    filled, away = nearest_values(depth.astype(np.float32, copy=False), read)
    return filled, away <= radius


def _in_bin(
    points: np.ndarray, bin_: Bin, config: DepthSegmenterConfig
) -> np.ndarray:
    return (points[..., 2] > config.floor_height) & (
        bin_.distance_to_walls(points) > config.wall_tolerance
    )


def _box(mask: np.ndarray, *, margin: int) -> tuple[slice, slice]:
    rows, columns = np.nonzero(mask)
    return (
        slice(max(rows.min() - margin, 0), rows.max() + margin + 1),
        slice(max(columns.min() - margin, 0), columns.max() + margin + 1),
    )


def _segments(
    depth: np.ndarray,
    height: np.ndarray,
    objects: np.ndarray,
    camera: PinholeCamera,
    arm: int,
    config: DepthSegmenterConfig,
) -> np.ndarray:
    """Returns (h, w) int32 labels, −1 for the background."""
    focal_length = camera.intrinsics[0, 0]
    concave = concavity(depth, focal_length, arm)
    fine = concavity(depth, focal_length, 1, across=False)
    seeds = _seeds(objects, concave < config.smooth)
    regions = _flooded(seeds, objects, concave + _FINE_WEIGHT * fine)
    graph = RegionGraph(
        regions, np.minimum(concave, config.most * config.join), height
    )
    graph.join_weak(config.join)
    graph.join_small(config.min_area)
    graph.join_hollows(config.enclosed)
    return graph.labels(config.min_area)


def _seeds(objects: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """Numbers the smooth surfaces, and what is small and not smooth at all."""
    count, seeds = cv2.connectedComponents(
        (objects & smooth).astype(np.uint8), connectivity=4
    )
    _, wholes = cv2.connectedComponents(
        objects.astype(np.uint8), connectivity=4
    )
    seeded = np.unique(wholes[seeds > 0])
    rough = objects & ~np.isin(wholes, seeded)
    seeds[rough] = count + wholes[rough]
    return seeds


def _flooded(
    seeds: np.ndarray, objects: np.ndarray, cost: np.ndarray
) -> np.ndarray:
    """Grows the seeds over the objects until they meet on the ridges."""
    top = np.iinfo(np.uint16).max
    steps = np.minimum(cost / _HEIGHT_STEP, top - 1).astype(np.uint16)
    regions = ndimage.watershed_ift(
        np.where(objects, steps, np.uint16(top)),
        np.where(objects, seeds, -1).astype(np.int32),
        structure=ndimage.generate_binary_structure(2, 1),
    )
    return np.where(objects, np.maximum(regions, 0), 0)


def _instances(labels: np.ndarray, target: np.ndarray) -> InstanceMasks:
    """Puts the target in its place among the segments."""
    areas = np.bincount(labels[labels >= 0])
    area = np.count_nonzero(target)
    if area:
        place = int(np.count_nonzero(areas >= area))
        labels[labels >= place] += 1
        labels[target] = place
    count = len(areas) + bool(area)
    return InstanceMasks(labels, tuple(f"segment_{i}" for i in range(count)))
