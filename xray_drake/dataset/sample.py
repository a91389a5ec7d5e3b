"""One labelled image of a heap, and the rules that it must obey."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.geometry.tilt import tilt

TARGET_INSTANCE = 1
"""The target's value in ``instances``; 0 is the background."""

FIRST_OBJECT_INSTANCE = 2
"""``object_names[i]`` has the value ``i + 2`` in ``instances``."""

METRES_PER_COUNT = 1e-4
"""Of the depth images on disk."""

MAX_DEPTH = 65535 * METRES_PER_COUNT
"""What 16 bits can hold, m."""

_DEPTH_TOLERANCE = 3 * METRES_PER_COUNT
"""Two depths that should be the same may differ by so much, m."""

_PIXEL_TOLERANCE = 2.0
"""A silhouette may lie this far outside its projection, pixels."""

_MASS_ON_VISIBLE = 0.8
"""Share of a wholly visible target's distribution on its modal mask. Candidates
agree with it to an IoU of 0.9; the rest is for rounding to pixels."""

_IMAGES: Mapping[str, type] = {
    "depth": np.float32,
    "depth_without_target": np.float32,
    "target_modal": np.bool_,
    "target_amodal": np.bool_,
    "instances": np.uint8,
    "occupancy": np.float32,
}

IMAGES = tuple(_IMAGES)
"""The fields of a sample that are (H, W) images; ``color`` is the seventh."""

MATRICES: Mapping[str, tuple[int, ...]] = {
    "intrinsics": (3, 3),
    "X_WC": (4, 4),
    "X_WT": (4, 4),
    "target_size": (3,),
}
"""The fields that are arrays of floats, and their shapes."""

NUMBERS = ("heap_seed", "view", "num_dropped")
"""The fields that are whole numbers."""


@dataclass(frozen=True, order=True)
class SampleKey:
    """What a sample is told apart by, and made again from.

    Attributes:
        heap_seed: of the heap.
        target_name: of the target in it.
        view: 0, 1, …: which camera.
        num_dropped: objects dropped when the picture was taken.
    """

    heap_seed: int
    target_name: str
    view: int
    num_dropped: int

    def __str__(self) -> str:
        return (
            f"heap {self.heap_seed}, {self.target_name}, view {self.view}, "
            f"{self.num_dropped} dropped"
        )


@dataclass(frozen=True, eq=False)
class Sample:
    """One labelled image; arrays are copied and made read-only.

    Images are noiseless, as rendered.

    Attributes:
        depth: (H, W) float32 z-depth, m; 0 where there is no reading.
        depth_without_target: the same of the scene without the target.
        target_modal: (H, W) bool, the target's visible pixels.
        target_amodal: (H, W) bool, its pixels were it alone in the scene.
        instances: (H, W) uint8; 0 background, 1 target, i + 2 the object
            ``object_names[i]``.
        occupancy: (H, W) float32, the label; its maximum is 1.
        intrinsics: (3, 3) camera matrix, pixels; centres at integers.
        X_WC: (4, 4) pose of the camera frame (x right, y down, z forward), m.
        X_WT: (4, 4) pose of the target's body frame (at the centre of its
            bounding box), m.
        target_size: (3,) length, width, thickness of the target's bounding
            box, m.
        object_names: the distractors in the bin; not the target.
        target_name: e.g. ``"box_2to1"``.
        heap_seed: what makes the heap again.
        view: 0, 1, …: which camera of the heap.
        num_dropped: distractors dropped when the picture was taken, those
            that fell outside the bin included.
        color: (H, W, 3) uint8 RGB, or None.
        bin: in which the heap lies.

    Raises:
        ValueError: an array has a shape that no image or matrix has, a name
            or a number does not fit.
    """

    depth: np.ndarray
    depth_without_target: np.ndarray
    target_modal: np.ndarray
    target_amodal: np.ndarray
    instances: np.ndarray
    occupancy: np.ndarray
    intrinsics: np.ndarray
    X_WC: np.ndarray
    X_WT: np.ndarray
    target_size: np.ndarray
    object_names: tuple[str, ...]
    target_name: str
    heap_seed: int
    view: int = 0
    num_dropped: int = 0
    color: np.ndarray | None = field(default=None, repr=False)
    bin: Bin = field(default_factory=Bin)

    def __post_init__(self) -> None:
        shape = np.shape(self.depth)
        if len(shape) != 2 or 0 in shape:
            raise ValueError(f"depth is {shape}, not (H, W)")
        layout: dict[str, tuple[type, tuple[int, ...]]] = {
            **{name: (dtype, shape) for name, dtype in _IMAGES.items()},
            **{name: (float, wanted) for name, wanted in MATRICES.items()},
        }
        if self.color is not None:
            layout["color"] = np.uint8, (*shape, 3)
        for name, (dtype, wanted) in layout.items():
            array: np.ndarray = np.array(getattr(self, name), dtype=dtype)
            if array.shape != wanted:
                raise ValueError(f"{name} is {array.shape}, not {wanted}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "object_names", tuple(self.object_names))
        for name in NUMBERS:
            number = int(getattr(self, name))
            if not 0 <= number < 2**63:
                raise ValueError(f"{name} is {number}: not in [0, 2^63)")
            object.__setattr__(self, name, number)

    @property
    def key(self) -> SampleKey:
        """Tells this sample from all others of a dataset."""
        return SampleKey(
            self.heap_seed, self.target_name, self.view, self.num_dropped
        )

    @property
    def shape(self) -> tuple[int, int]:
        """``(height, width)`` of all images."""
        height, width = self.depth.shape
        return height, width

    @property
    def camera(self) -> PinholeCamera:
        """The camera of all images."""
        height, width = self.shape
        return PinholeCamera(
            width=width,
            height=height,
            intrinsics=self.intrinsics,
            X_WC=self.X_WC,
        )

    @property
    def floor(self) -> Floor:
        """The inside of the bin's floor."""
        return self.bin.floor

    @property
    def visible_fraction(self) -> float:
        """Visible share of the target's amodal mask; 0 where that is blank."""
        area = np.count_nonzero(self.target_amodal)
        return np.count_nonzero(self.target_modal) / area if area else 0.0

    @property
    def target_tilt(self) -> float:
        """Angle between the target's z axis and the vertical, rad.

        Either face may lie down.
        """
        return tilt(self.X_WT)


def depth_on_disk(depth: np.ndarray) -> np.ndarray:
    """Returns a sensor's depth image as a dataset holds it.

    Args:
        depth: (H, W) z-depth, m; 0, negative, infinite, NaN, or beyond
            :data:`MAX_DEPTH`: no reading.

    Returns:
        (H, W) float32, m, rounded to :data:`METRES_PER_COUNT`; 0 where there
        is no reading.
    """
    return decode_depth(encode_depth(depth))


def encode_depth(depth: np.ndarray) -> np.ndarray:
    """Returns (H, W) uint16 counts of :data:`METRES_PER_COUNT`.

    Args:
        depth: see :func:`depth_on_disk`.
    """
    depth = np.asarray(depth, dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        counts = np.rint(depth / METRES_PER_COUNT)
        valid = (counts > 0) & (counts <= 65535)
        return np.where(valid, counts, 0).astype(np.uint16)


def decode_depth(counts: np.ndarray) -> np.ndarray:
    """Returns a depth image, float32, m, from its counts.

    Args:
        counts: (H, W) uint16, as of :func:`encode_depth`; 0: no reading.
    """
    return counts.astype(np.float32) * np.float32(METRES_PER_COUNT)


def encode_occupancy(occupancy: np.ndarray) -> np.ndarray:
    """Returns a distribution × 255 as uint8.

    What is above 0 stays above 0, so that the support stays as it is.

    Args:
        occupancy: any shape, in [0, 1].
    """
    scaled = np.rint(np.clip(occupancy, 0.0, 1.0) * 255)
    return np.where(occupancy > 0, np.maximum(scaled, 1), 0).astype(np.uint8)


def decode_occupancy(stored: np.ndarray) -> np.ndarray:
    """Returns a distribution, float32 in [0, 1], from what is stored.

    Args:
        stored: uint8 of any shape, as of :func:`encode_occupancy`.
    """
    return stored.astype(np.float32) / np.float32(255)


def problems(sample: Sample) -> list[str]:
    """Returns what cannot be true of a sample, one line each.

    Holds for whatever was rendered and labelled by PROTOCOL.md, before it is
    written and after it was read; an empty list means a sound sample.
    """
    numbers = list(_numbers(sample))
    return [
        *numbers,
        *_masks(sample),
        *_depths(sample),
        *_distribution(sample),
        *([] if numbers else _geometry(sample)),
    ]


def _numbers(sample: Sample) -> Iterator[str]:
    for name in ("X_WC", "X_WT"):
        if not _is_rigid(getattr(sample, name)):
            yield f"{name} is not a rigid pose"
    K = sample.intrinsics
    if not (
        np.all(np.isfinite(K))
        and K[0, 0] > 0
        and K[1, 1] > 0
        and K[0, 1] == K[1, 0] == 0
        and np.array_equal(K[2], [0, 0, 1])
    ):
        yield "intrinsics is not a camera matrix without skew"
    size = sample.target_size
    if not (np.all(np.isfinite(size)) and np.all(size > 0)):
        yield f"target_size is {size.tolist()}: not three positive lengths"
    if not sample.target_name:
        yield "target_name is empty"
    if len(set(sample.object_names)) != len(sample.object_names):
        yield "object_names holds a name twice"
    if sample.target_name in sample.object_names:
        yield f"object_names holds the target, {sample.target_name}"
    if len(sample.object_names) > sample.num_dropped:
        yield (
            f"{len(sample.object_names)} objects in the bin, but only "
            f"{sample.num_dropped} dropped"
        )


def _masks(sample: Sample) -> Iterator[str]:
    modal, amodal = sample.target_modal, sample.target_amodal
    if not amodal.any():
        yield "target_amodal is blank: the target is not in the image"
    outside = np.count_nonzero(modal & ~amodal)
    if outside:
        yield f"{outside} pixels of target_modal outside target_amodal"
    differ = np.count_nonzero(modal != (sample.instances == TARGET_INSTANCE))
    if differ:
        yield f"target_modal and instances == 1 differ in {differ} pixels"
    last = len(sample.object_names) + FIRST_OBJECT_INSTANCE - 1
    if sample.instances.max() > last:
        yield (
            f"instances has the value {sample.instances.max()}, but "
            f"{len(sample.object_names)} objects end at {last}"
        )


def _depths(sample: Sample) -> Iterator[str]:
    with_, without = sample.depth, sample.depth_without_target
    modal = sample.target_modal
    for name, depth in (("depth", with_), ("depth_without_target", without)):
        if not (np.all(np.isfinite(depth)) and np.all(depth >= 0)):
            yield f"{name} has values that are negative or not finite"
        elif depth.max() > MAX_DEPTH + _DEPTH_TOLERANCE:
            yield f"{name} reaches {depth.max():g} m, beyond {MAX_DEPTH:g} m"
        else:
            continue
        return
    differ = np.abs(with_ - without) > _DEPTH_TOLERANCE
    count = np.count_nonzero(differ & ~modal)
    if count:
        yield (
            "depth and depth_without_target differ in "
            f"{count} pixels outside target_modal"
        )
    behind = (without > 0) & (with_ > without + _DEPTH_TOLERANCE)
    count = np.count_nonzero(modal & behind)
    if count:
        yield f"{count} pixels of target_modal lie behind the scene without it"


def _distribution(sample: Sample) -> Iterator[str]:
    rho = sample.occupancy
    if not np.all(np.isfinite(rho)) or rho.min() < 0 or rho.max() > 1:
        yield "occupancy has values outside [0, 1]"
        return
    amodal = sample.target_amodal
    if amodal.any() and abs(rho.max() - 1) > 1e-6:
        yield f"occupancy has the maximum {rho.max():g}, not 1"
    missed = np.count_nonzero(amodal & (rho <= 0))
    if missed:
        yield f"occupancy is 0 in {missed} pixels of target_amodal"
    modal = sample.target_modal
    if modal.any() and np.array_equal(modal, amodal):
        share = rho[modal].sum() / rho.sum() if rho.any() else 0.0
        if share < _MASS_ON_VISIBLE:
            yield (
                "the target is wholly visible, but only "
                f"{share:.0%} of occupancy lies on it"
            )


def _geometry(sample: Sample) -> Iterator[str]:
    """The target's pixels lie where its pose says, by its bounding sphere."""
    radius = np.linalg.norm(sample.target_size) / 2
    u, v, z = sample.camera.project(sample.X_WT[:3, 3])
    if z <= radius:
        yield "the target is not in front of the camera"
        return
    rows, columns = np.nonzero(sample.target_amodal)
    if rows.size:
        # A ball seen off the axis reaches a little further than r·f/z.
        off_axis = np.hypot(
            (u - sample.intrinsics[0, 2]) / sample.intrinsics[0, 0],
            (v - sample.intrinsics[1, 2]) / sample.intrinsics[1, 1],
        )
        reach = (
            sample.intrinsics[[0, 1], [0, 1]].max()
            * radius
            / (z - radius)
            * np.hypot(1.0, off_axis)
        )
        far = np.hypot(columns - u, rows - v).max()
        if far > reach + _PIXEL_TOLERANCE:
            yield (
                f"target_amodal reaches {far:.1f} pixels from where X_WT and "
                f"X_WC put the target; its size allows {reach:.1f}"
            )
    seen = sample.depth[sample.target_modal]
    seen = seen[seen > 0]
    if seen.size:
        deepest = np.abs(seen - z).max()
        if deepest > radius + _DEPTH_TOLERANCE:
            yield (
                f"target_modal is {deepest:.4f} m from the depth that X_WT "
                f"and X_WC give; its size allows {radius:.4f} m"
            )


def _is_rigid(X: np.ndarray) -> bool:
    R = X[:3, :3]
    return bool(
        np.all(np.isfinite(X))
        and np.array_equal(X[3], [0, 0, 0, 1])
        and np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-6)
        and np.linalg.det(R) > 0
    )
