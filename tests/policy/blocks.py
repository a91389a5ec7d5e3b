"""Blocks seen from straight above, painted into images."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.nominal import BIN
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GraspPlan,
    InstanceMasks,
    OccupancyDistribution,
)
from xray_drake.policy.beyond.shifts import Look
from xray_drake.policy.ranking import Outlook, Planning, SearchView

WIDTH, HEIGHT = 128, 96
SHAPE = HEIGHT, WIDTH
CAMERA_HEIGHT = 0.8
FOCAL = 138.0
SCALE = FOCAL / CAMERA_HEIGHT
"""Pixels per metre of the floor; one is 5.8 mm."""

TARGET = "target"
TARGET_SIZE = np.array([0.06, 0.03, 0.005])
"""10 × 5 pixels."""

FLOOR = BIN.floor
"""Inside of the bin floor, m."""


def overhead_camera() -> PinholeCamera:
    K = np.array([[FOCAL, 0, 63.5], [0, FOCAL, 47.5], [0, 0, 1]])
    X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WC[2, 3] = CAMERA_HEIGHT
    return PinholeCamera(WIDTH, HEIGHT, K, X_WC)


@dataclass(frozen=True)
class Block:
    """A block whose sides are not seen: rows and columns, and its top, m."""

    name: str
    row: int
    column: int
    rows: int
    columns: int
    top: float = 0.03

    def moved(self, down: int, right: int) -> "Block":
        return replace(self, row=self.row + down, column=self.column + right)

    @property
    def mask(self) -> np.ndarray:
        """Its pixels, as if nothing were before it."""
        mask = np.zeros(SHAPE, bool)
        rows = slice(max(self.row, 0), max(self.row + self.rows, 0))
        columns = slice(max(self.column, 0), max(self.column + self.columns, 0))
        mask[rows, columns] = True
        return mask


def target_block(row: int, column: int) -> Block:
    return Block(TARGET, row, column, 5, 10, float(TARGET_SIZE[2]))


def look(blocks: Sequence[Block]) -> Look:
    """Looks at blocks on the floor; a block called TARGET is the target."""
    heights = np.zeros(SHAPE, np.float32)
    labels = np.full(SHAPE, -1)
    names = tuple(block.name for block in blocks)
    for i, block in enumerate(blocks):
        above = block.mask & (block.top > heights)
        heights[above], labels[above] = block.top, i
    target = labels == names.index(TARGET) if TARGET in names else labels == -2
    return Look(CAMERA_HEIGHT - heights, target, InstanceMasks(labels, names))


def heights_of(depth: np.ndarray) -> np.ndarray:
    return CAMERA_HEIGHT - depth


def hidden_places(
    depth: np.ndarray, target_mask: np.ndarray
) -> OccupancyDistribution:
    """A simple inference: anything as high as the target may be over it."""
    hidden = heights_of(depth) > TARGET_SIZE[2] - 1e-4
    return OccupancyDistribution(hidden, method="blocks")


def outlook(seen: Look) -> Outlook:
    return Outlook(
        seen.depth,
        seen.target,
        overhead_camera(),
        TARGET_SIZE,
        hidden_places,
    )


def planning(
    qualities: dict[str, float],
    freed: dict[tuple[str, str], float] | None = None,
) -> Planning:
    """Plans grasps of given quality.

    Args:
        qualities: by object; others have no grasp.
        freed: by object and what is thought away.
    """

    def plan(name: str, *, without: Sequence[str] = ()) -> GraspPlan:
        quality = qualities.get(name, 0.0)
        for gone in without:
            quality = (freed or {}).get((name, gone), quality)
        kind = GraspKind.JAW if quality else GraspKind.NONE
        return GraspPlan(Grasp(kind, name if quality else "", quality=quality))

    return plan


def view(
    blocks: Sequence[Block], plan: Planning, rho: np.ndarray | None = None
) -> SearchView:
    """What a ranking sees of blocks; by default the distribution is inferred.

    Args:
        blocks: on the floor.
        plan: plans grasps.
        rho: where the target can be, if that is known.
    """
    seen = look(blocks)
    return SearchView(
        hidden_places(seen.depth, seen.target)
        if rho is None
        else OccupancyDistribution(rho),
        seen.instances,
        tuple(block.name for block in blocks),
        TARGET if seen.target.any() else "",
        plan,
        outlook(seen),
    )
