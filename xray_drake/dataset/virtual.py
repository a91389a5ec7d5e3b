"""Targets that were never in the heap, placed into its images.

Dropping a heap costs seconds, a label milliseconds. The scene without the
target is in the dataset, and the paper's label needs no more than that and the
target's own depth image: so the same heap can be labelled for any target, of
any size, lying flat anywhere. Such a target may stand where an object stands;
the images do not show it. Where a target lies is made up, so the amodal mask
says nothing about where heaps hide things: :func:`is_virtual`.
"""

from dataclasses import dataclass, replace

import numpy as np

from xray_drake.dataset.sample import (
    FIRST_OBJECT_INSTANCE,
    TARGET_INSTANCE,
    Sample,
    depth_on_disk,
)
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.convex import hull_planes
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.label.config import LabelConfig
from xray_drake.occupancy.label.ground_truth import occupancy_label

VIRTUAL_PREFIX = "virtual_"
"""Of the names of such targets."""

_RATIOS = (1.0, 10.0)
"""Length over width."""

_SCALES = (0.6, 2.4)
"""√(length × width) over 3 cm, the paper's boxes'."""

_LONGEST, _NARROWEST = 0.14, 0.007
"""m, of length and width."""

_THICKNESSES = (0.003, 0.018)
"""m, but no thicker than wide."""

_SHARES = {"box": 0.6, "disc": 0.25, "rod": 0.15}
_UNDER_OBJECTS = 0.8
"""Share that is placed under what stands in the bin, not anywhere."""

HIDDEN = 0.4
"""Share for which a place is sought where nothing of it is seen."""

_MOST_VISIBLE = 0.95
"""The others are seen in part."""

_TARGETS, _PLACES = 4, 10
"""So many targets are tried, at so many places each."""

_CORNERS = 24
"""Of a disc."""


@dataclass(frozen=True, eq=False)
class VirtualTarget:
    """A convex body.

    Attributes:
        name: begins with :data:`VIRTUAL_PREFIX`.
        size: (3,) length, width, thickness of its bounding box, m.
        vertices: (n, 3) in its frame, which is centred on the bounding box.
        planes: (k, 4) of its faces; inside, planes · (x, y, z, 1) ≤ 0.
    """

    name: str
    size: np.ndarray
    vertices: np.ndarray
    planes: np.ndarray


def is_virtual(target_name: str) -> bool:
    """Says whether a sample's target was placed by this module."""
    return target_name.startswith(VIRTUAL_PREFIX)


def draw_target(rng: np.random.Generator) -> VirtualTarget:
    """Draws a box, a disc or a lying rod of any size a target may have."""
    kind = str(rng.choice(list(_SHARES), p=list(_SHARES.values())))
    ratio = float(np.exp(rng.uniform(*np.log(_RATIOS))))
    scale = float(np.exp(rng.uniform(*np.log(_SCALES))))
    length = min(0.03 * scale * np.sqrt(ratio), _LONGEST)
    width = max(0.03 * scale / np.sqrt(ratio), _NARROWEST)
    thickness = min(float(rng.uniform(*_THICKNESSES)), width)
    if kind == "rod":
        width = min(width, 0.03)
        thickness = width
    return make_target(kind, np.array([length, width, thickness]))


def make_target(kind: str, size: np.ndarray) -> VirtualTarget:
    """Makes a target.

    Args:
        kind: box, disc (an elliptic plate), or rod (a lying cylinder).
        size: (3,) length, width, thickness, m.

    Raises:
        ValueError: no such kind.
    """
    angles = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) / 2
    ends = np.array([-0.5, 0.5])
    if kind == "box":
        unit = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    elif kind == "disc":
        unit = np.array([[x, y, z] for x, y in ring for z in ends])
    elif kind == "rod":
        unit = np.array([[x, y, z] for y, z in ring for x in ends])
    else:
        raise ValueError(f"no kind of target is called {kind!r}")
    vertices = unit * size
    millimetres = "x".join(f"{1e3 * length:.0f}" for length in size)
    name = f"{VIRTUAL_PREFIX}{kind}_{millimetres}"
    return VirtualTarget(
        name, np.array(size, float), vertices, hull_planes(vertices)
    )


def virtual_target(sample: Sample) -> VirtualTarget:
    """Returns the target of a sample of :func:`virtual_sample`.

    Raises:
        ValueError: the sample's target is none of these.
    """
    name = sample.target_name
    if not is_virtual(name):
        raise ValueError(f"{name!r} is no virtual target")
    kind, _, _ = name.removeprefix(VIRTUAL_PREFIX).partition("_")
    return make_target(kind, sample.target_size)


def target_depth(
    target: VirtualTarget, X_WT: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    """Renders a target alone.

    Args:
        target: to be rendered.
        X_WT: (4, 4) pose, m.
        camera: that looks at it.

    Returns:
        (H, W) float32 z-depth, m; 0 where it is not.
    """
    image = np.zeros(camera.shape, np.float32)
    corners = target.vertices @ X_WT[:3, :3].T + X_WT[:3, 3]
    uvz = camera.project(corners)
    if (uvz[:, 2] <= 0).any():
        return image
    low = np.maximum(np.floor(uvz[:, :2].min(axis=0)), 0).astype(int)
    high = np.ceil(uvz[:, :2].max(axis=0)).astype(int) + 1
    high = np.minimum(high, [camera.width, camera.height])
    if (high <= low).any():
        return image
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    pixels = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    to_body = X_WT[:3, :3].T
    rays = (
        pixels
        @ (to_body @ camera.X_WC[:3, :3] @ np.linalg.inv(camera.intrinsics)).T
    )
    origin = to_body @ (camera.X_WC[:3, 3] - X_WT[:3, 3])
    # A ray is inside where it has entered all half-spaces and left none.
    speed = rays @ target.planes[:, :3].T
    distance = -(target.planes[:, :3] @ origin + target.planes[:, 3])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = distance / speed
    enter = np.where(speed < 0, crossing, -np.inf).max(axis=1)
    leave = np.where(speed > 0, crossing, np.inf).min(axis=1)
    hit = (enter < leave) & (enter > 0)
    hit &= ((speed != 0) | (distance >= 0)).all(axis=1)
    crop = np.where(hit, enter, 0.0).reshape(u.shape)
    image[low[1] : high[1], low[0] : high[0]] = crop
    return image


def virtual_sample(
    sample: Sample,
    rng: np.random.Generator,
    *,
    config: LabelConfig | None = None,
    size: np.ndarray | None = None,
    hidden: float = HIDDEN,
) -> Sample | None:
    """Takes the target out of an image and puts another one there.

    Args:
        sample: of a real heap.
        rng: draws target and place.
        config: of the label.
        size: (3,) length, width, thickness of a box, m, that is the target;
            None draws one of any kind and size.
        hidden: probability that a place is sought where nothing of it is seen.

    Returns:
        The sample with images, label, pose, size and name of the new target;
        None if no place was found for it.
    """
    config = config or LabelConfig()
    camera, scene = sample.camera, sample.depth_without_target
    under = _under_objects(scene, camera, sample.floor)
    most = 0.0 if rng.random() < hidden else _MOST_VISIBLE
    found = None
    for attempt in range(_TARGETS * _PLACES):
        if attempt % _PLACES == 0:
            target = (
                draw_target(rng) if size is None else make_target("box", size)
            )
        X_WT = _place(target, under, rng, sample.floor)
        if X_WT is None:
            continue
        alone = target_depth(target, X_WT, camera)
        if not _whole(alone, target, X_WT, camera):
            continue
        with np.errstate(invalid="ignore"):
            seen = (alone > 0) & (
                (scene <= 0) | (scene - alone > config.depth_tolerance)
            )
        found = target, X_WT, alone, seen
        share = np.count_nonzero(seen) / np.count_nonzero(alone)
        if share <= most and (share > 0 or most == 0):
            break
    if found is None:
        return None
    target, X_WT, alone, seen = found
    label = occupancy_label(
        alone,
        scene,
        camera,
        X_WT[:3, 3],
        floor=sample.floor,
        observed=seen,
        config=config,
    )
    if not label.distribution.any():
        return None
    # Where the old target was seen, whatever is there now is the floor.
    instances = np.where(
        sample.instances >= FIRST_OBJECT_INSTANCE, sample.instances, 0
    )
    return replace(
        sample,
        depth=depth_on_disk(np.where(seen, alone, scene)),
        target_modal=seen,
        target_amodal=label.amodal,
        instances=np.where(seen, TARGET_INSTANCE, instances),
        occupancy=label.distribution,
        X_WT=X_WT,
        target_size=target.size,
        target_name=target.name,
        color=None,
    )


def _under_objects(
    scene: np.ndarray, camera: PinholeCamera, floor: Floor
) -> np.ndarray:
    """(n, 2) x and y of what is seen higher than the floor in the bin, m."""
    points = camera.unproject(np.where(scene > 0, scene, np.nan))
    inside = (points[..., 2] > 0.01) & floor.contains(points)
    return points[inside][:, :2]


def _place(
    target: VirtualTarget,
    under: np.ndarray,
    rng: np.random.Generator,
    floor: Floor,
) -> np.ndarray | None:
    """Draws a (4, 4) pose on the floor, or None if it leaves the bin."""
    (x_low, x_high), (y_low, y_high) = floor.x, floor.y
    if rng.random() < _UNDER_OBJECTS:
        if not len(under):
            return None
        x, y = under[rng.integers(len(under))]
    else:
        x, y = rng.uniform(x_low, x_high), rng.uniform(y_low, y_high)
    yaw = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    X_WT = np.eye(4)
    X_WT[:2, :2] = [[c, -s], [s, c]]
    X_WT[:3, 3] = [x, y, target.size[2] / 2]
    corners = target.vertices[:, :2] @ X_WT[:2, :2].T + [x, y]
    low, high = corners.min(axis=0), corners.max(axis=0)
    outside = (low < [x_low, y_low]).any() or (high > [x_high, y_high]).any()
    return None if outside else X_WT


def _whole(
    alone: np.ndarray,
    target: VirtualTarget,
    X_WT: np.ndarray,
    camera: PinholeCamera,
) -> bool:
    """Says whether a target is in the image, all of it."""
    corners = target.vertices @ X_WT[:3, :3].T + X_WT[:3, 3]
    u, v, _ = camera.project(corners).T
    return bool(
        alone.any()
        and u.min() >= 0
        and u.max() <= camera.width - 1
        and v.min() >= 0
        and v.max() <= camera.height - 1
    )
