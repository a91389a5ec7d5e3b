"""The ground-truth occupancy distribution, as the paper defines it."""

from dataclasses import dataclass

import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.configuration import check
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.geometry.readings import (
    check_shapes,
    depth_readings,
    has_reading,
)
from xray_drake.occupancy.label.config import LabelConfig
from xray_drake.occupancy.label.kernels import (
    Candidates,
    count_hidden,
    count_seen,
    find_runs,
    nearest,
    relative_depths,
    rotate_target,
)

__all__ = ["Label", "LabelConfig", "occupancy_label"]


@dataclass(frozen=True, eq=False)
class Label:
    """The ground truth of one image.

    Attributes:
        distribution: (H, W) float32 in [0, 1]; its maximum is 1, or all is 0.
        amodal: (H, W) bool, the target's pixels as if nothing were before it.
        modal: (H, W) bool, the modal mask that the candidates were compared
            with.
        accepted: (rotations,) int, how many candidates of each orientation
            were summed; the first orientation is the true one.
        largest: the sum's maximum, which the distribution was divided by.
    """

    distribution: np.ndarray
    amodal: np.ndarray
    modal: np.ndarray
    accepted: np.ndarray
    largest: float = 0.0


def occupancy_label(
    target_depth: np.ndarray,
    scene_depth: np.ndarray,
    camera: PinholeCamera,
    p_WT: np.ndarray,
    *,
    floor: Floor | None = None,
    observed: np.ndarray | None = None,
    true_pose: bool = True,
    config: LabelConfig | None = None,
) -> Label:
    """Computes where the target could be without a change to its modal mask.

    The target's own depth image is turned about the projection of its body
    origin, shifted over the image, and offset by the depth of the floor. A
    candidate is accepted if its modal mask, that is where it is in front of
    the scene, has an IoU above ``accept_iou`` with the observed one, or, where
    nothing of the target is seen, if it is blank. The distribution is the sum
    of the accepted candidates' amodal masks, divided by its maximum (paper
    section IV.A; PROTOCOL.md "The label, in detail").

    Shifts are the multiples of ``step`` that keep the turning point's pixel in
    the image, so the true pose is one of the candidates. A pixel of a turned
    target is that of the untouched one which is nearest to where it comes
    from. Candidates with a pixel beyond the image, or one whose ray meets
    z = 0 outside the bin floor, do not count. The true pose always does, with
    one exception: if nothing is observed though nothing hides it, the images
    contradict each other and the distribution is empty.

    Args:
        target_depth: (H, W) z-depth of the target alone (without the floor),
            m; 0 or inf where it is not.
        scene_depth: (H, W) z-depth of everything else, bin included, m;
            0, inf and NaN are no reading and hide nothing.
        camera: the camera of both, above the floor.
        p_WT: (3,) origin of the target's body in the world, m.
        floor: inside of the bin's; by default the nominal bin's.
        observed: (H, W) bool, the modal mask if it is known from elsewhere (a
            label image). Without it, it is where the target is nearer than
            the scene by more than ``depth_tolerance``.
        true_pose: the target is imaged where it is, so that this pose always
            counts. Otherwise it is as good as any other candidate, as where
            it is shown lying on another of its faces.
        config: the numbers.

    Returns:
        The label.

    Raises:
        ValueError: images of another shape than the camera's, a negative
            depth, a target image with NaN or without a target, a turning point
            outside the image, a camera that is not above the floor, or numbers
            that make no candidates.
    """
    config = config or LabelConfig()
    target, scene = _checked(
        target_depth, scene_depth, observed, camera, config
    )
    amodal = has_reading(target)
    pivot = _pivot(p_WT, camera)
    relative, floor_depth = _relative(
        scene, camera, floor or Bin().floor, config
    )
    computed = _modal(target, scene, amodal, config.depth_tolerance)
    modal = computed if observed is None else np.array(observed, dtype=bool)
    box = _box(modal) if modal.any() else None
    candidates = _candidates(
        target, _box(amodal), floor_depth, pivot, box, config
    )
    accepted, total = _counted(relative, modal, candidates, config)
    if true_pose and (box is not None or (computed != amodal).any()):
        accepted[0] += 1
        total += amodal
    largest = float(total.max())
    distribution = total.astype(np.float32) / np.float32(max(largest, 1.0))
    return Label(distribution, amodal, modal, accepted, largest)


def _counted(
    relative: np.ndarray,
    modal: np.ndarray,
    candidates: Candidates,
    config: LabelConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns how many of each turn are accepted, and (H, W) their sum."""
    height, width = modal.shape
    change = np.zeros((height, width + 1), dtype=np.int32)
    if modal.any():
        accepted = count_seen(
            relative, modal, candidates, config.accept_iou, change
        )
    else:
        accepted = count_hidden(relative, candidates, change)
    return accepted, np.cumsum(change[:, :-1], axis=1, dtype=np.int32)


def _relative(
    scene: np.ndarray, camera: PinholeCamera, floor: Floor, config: LabelConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (H, W) depths of scene and floor; see ``relative_depths``."""
    outward = config.floor_tolerance * np.array([-1.0, 1.0, -1.0, 1.0])
    return relative_depths(
        scene,
        camera.pixel_to_ray,
        np.array(camera.X_WC[:3, 3]),
        np.array([*floor.x, *floor.y]) + outward,
        config.depth_tolerance,
    )


def _candidates(
    target: np.ndarray,
    own: np.ndarray,
    floor: np.ndarray,
    pivot: np.ndarray,
    reached: np.ndarray | None,
    config: LabelConfig,
) -> Candidates:
    """Turns the target to all orientations, and finds where each may be.

    Args:
        target: (H, W) z-depth, m.
        own: (2, 2) first and last u, v of its pixels.
        floor: (H, W) z-depth of the floor, m.
        pivot: (2,) u, v of the turning point.
        reached: (2, 2) first and last u, v of what candidates must reach, if
            anything.
        config: the number of orientations, and the shifts.
    """
    farthest = np.abs(own - pivot).max(axis=0)
    reach = int(np.ceil(np.hypot(*farthest))) + 1
    corner = np.floor(pivot).astype(np.int64) - reach
    angles = 2 * np.pi * np.arange(config.rotations) / config.rotations
    # Rounded, so that a quarter of a turn is one exactly.
    turns = np.stack([np.cos(angles), np.sin(angles)], axis=1).round(12)
    rasters = rotate_target(target, floor, pivot, turns, corner, 2 * reach + 2)
    size = np.array(target.shape[::-1])
    shifts = _shifts(rasters, corner, pivot, size, config.step, reached)
    return Candidates(
        rasters, *find_runs(rasters), *shifts, corner, config.step
    )


def _checked(
    target_depth: np.ndarray,
    scene_depth: np.ndarray,
    observed: np.ndarray | None,
    camera: PinholeCamera,
    config: LabelConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns both (H, W) float32 depth images, m, or refuses them."""
    images = {
        "target's depth image": np.asarray(target_depth),
        "scene's depth image": np.asarray(scene_depth),
    }
    if observed is not None:
        images["observed modal mask"] = np.asarray(observed)
    check_shapes(images, camera)
    images.pop("observed modal mask", None)
    # Copies: to numba, an array that may not be written is another type.
    depths = {
        name: np.array(depth_readings(image, camera), order="C")
        for name, image in images.items()
    }
    for name, image in depths.items():
        if (image < 0).any():
            raise ValueError(
                f"the {name} has a negative depth ({np.nanmin(image):.3f} m)"
            )
    target, scene = depths.values()
    if np.isnan(target).any():
        raise ValueError(
            "the target's depth image has NaN; where there is no target it "
            "must be 0 or inf"
        )
    if not has_reading(target).any():
        raise ValueError(
            "the target's image is empty: no pixel has a depth, so the target "
            "is out of the camera's view"
        )
    check(config, "label")
    return target, scene


def _pivot(p_WT: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Returns the (2,) u, v of the body's origin."""
    p_WT = np.asarray(p_WT, dtype=float)
    if p_WT.shape != (3,) or not np.isfinite(p_WT).all():
        raise ValueError(
            f"the target's origin must be three finite numbers, not {p_WT}"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, depth = camera.project(p_WT)
    if not (
        depth > 0
        and -0.5 <= u < camera.width - 0.5
        and -0.5 <= v < camera.height - 0.5
    ):
        raise ValueError(
            f"the target's origin {p_WT.tolist()} is outside the image"
        )
    return np.array([u, v])


def _modal(
    target: np.ndarray, scene: np.ndarray, amodal: np.ndarray, tolerance: float
) -> np.ndarray:
    """Returns where the target is in front of the scene."""
    modal = amodal.copy()
    behind = scene[amodal].astype(float)
    read = has_reading(behind)
    modal[amodal] = ~read | (behind - target[amodal] > tolerance)
    return modal


def _box(mask: np.ndarray) -> np.ndarray:
    """Returns (2, 2): first u, v and last u, v of a mask's pixels."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    return np.array([[columns[0], rows[0]], [columns[-1], rows[-1]]])


def _shifts(
    rasters: np.ndarray,
    corner: np.ndarray,
    pivot: np.ndarray,
    size: np.ndarray,
    step: int,
    box: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the shifts of candidates that keep within the image.

    Args:
        rasters: (k, side, side), NaN beside the mask.
        corner: (2,) u, v of their first pixel.
        pivot: (2,) u, v of the turning point; its pixel keeps in the image too.
        size: (2,) width and height of the image.
        step: pixels.
        box: first and last u, v of what the candidates must reach, if any.

    Returns:
        (k, 2) first and (k, 2) last shift in u and in v, in steps; last is
        less than first where there is none.
    """
    covered = ~np.isnan(rasters)
    reference = np.array([nearest(value) for value in pivot])
    first = np.empty((len(rasters), 2), dtype=np.int64)
    last = np.empty_like(first)
    for k, mask in enumerate(covered):
        if not mask.any():
            first[k], last[k] = 0, -1
            continue
        own = _box(mask) + corner
        low = -np.minimum(own[0], reference)
        high = size - 1 - np.maximum(own[1], reference)
        if box is not None:
            low = np.maximum(low, box[0] - own[1])
            high = np.minimum(high, box[1] - own[0])
        first[k], last[k] = -(-low // step), high // step
    return first, last
