"""Bin and tote: boxes without a lid, whose walls may slope."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from xray_drake.configuration import (
    number,
    number_list,
)
from xray_drake.geometry.floor_grid import Floor
from xray_drake.trees import ConfigurationError

_BELOW = 0.01
"""A body whose origin is this far under the floor has left, m."""

_CATCHES = 6
_CATCH_STEP = 0.002
"""Slabs inside a thick floor, and how much deeper each begins, m. A rigid
surface feels a soft body only where it cuts it: one that is knocked below the
floor's top within a step would fall on. These catch it; nothing at rest reaches
them."""

_GAP = 0.16
"""Between the outside of the bin and that of the tote beside it, m."""


@dataclass(frozen=True, eq=False)
class Slab:
    """One of the boxes that a bin is made of.

    Attributes:
        name: of it, unique in the bin.
        size: (3,) of its sides, m.
        X_BS: 4×4 pose of its centre in the bin's frame B, m.
        seen: it is drawn; otherwise it only collides.
    """

    name: str
    size: np.ndarray
    X_BS: np.ndarray
    seen: bool = True

    def corners(self) -> np.ndarray:
        """Returns its (8, 3) corners in the bin's frame, m."""
        signs = np.array(
            [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        )
        return self.X_BS[:3, 3] + signs * self.size / 2 @ self.X_BS[:3, :3].T


@dataclass
class OpenBox:
    """A box without a lid. Its frame B is at the middle of the floor's inside.

    x is along its length, y along its width, z up; the floor's top is z = 0.
    """

    # Inside of the floor along x and along y, m.
    length: float = number(0.50, "(0, 5]")
    width: float = number(0.40, "(0, 5]")
    # Height of the walls over the floor, m.
    wall_height: float = number(0.12, "[0, 2]")
    # Of walls and floor, m.
    wall_thickness: float = number(0.02, "(0, 0.5]")
    # How far the walls lean outwards, degrees; the inside is wider at the top.
    wall_slope: float = number(0.0, "[0, 45]")

    @property
    def floor(self) -> Floor:
        """The inside of its floor."""
        half = np.array([self.length, self.width]) / 2
        (x, y) = ((-float(side), float(side)) for side in half)
        return Floor(x, y)

    @property
    def half_size(self) -> np.ndarray:
        """Half of its (2,) length and width, m."""
        return np.array([self.length, self.width]) / 2

    @property
    def outside(self) -> np.ndarray:
        """Half of its (2,) length and width at the top, walls and all, m."""
        lean = self.wall_height * np.tan(np.deg2rad(self.wall_slope))
        return self.half_size + lean + self.wall_thickness

    def distance_to_walls(self, p_B: np.ndarray) -> np.ndarray:
        """Returns how far points stay from the inside of the walls.

        Args:
            p_B: (..., 3) points in the bin's frame, m.

        Returns:
            (...) the least distance across the walls, m; negative beyond one.
        """
        slope = np.deg2rad(self.wall_slope)
        wider = np.tan(slope) * p_B[..., 2:]
        room = self.half_size + wider - np.abs(p_B[..., :2])
        return np.cos(slope) * room.min(axis=-1)

    def is_over(self, p_B: np.ndarray) -> bool:
        """Says whether a point (3,) is in the box or above it, m."""
        z = min(max(p_B[2], 0.0), self.wall_height)
        level = np.array([p_B[0], p_B[1], z])
        return bool(self.distance_to_walls(level) > 0 and p_B[2] > -_BELOW)

    def slabs(self) -> tuple[Slab, ...]:
        """Returns floor and walls, and what catches what sinks into the floor.

        A thin floor has no room for the latter.
        """
        t, slope = self.wall_thickness, np.deg2rad(self.wall_slope)
        length, width = 2 * self.half_size
        lean = 2 * self.wall_height * float(np.tan(slope))
        side = self.wall_height / float(np.cos(slope))
        slabs = []
        catches = _CATCHES if t > _CATCHES * _CATCH_STEP else 0
        for catch in range(catches + 1):
            down = catch * _CATCH_STEP
            slabs.append(
                _slab(
                    f"floor_{1000 * down:.0f}_mm_down" if catch else "floor",
                    [length + 2 * t, width + 2 * t, t - down],
                    [0.0, 0.0, -(t + down) / 2],
                    seen=not catch,
                )
            )
        for axis, across, size in (
            ("x", 0, [t, width + 2 * t + lean, side]),
            ("y", 1, [length + lean, t, side]),
        ):
            for name, sign in (("high", 1.0), ("low", -1.0)):
                # About the edge at which the wall's inside meets the floor.
                middle = np.zeros(3)
                middle[across], middle[2] = sign * t / 2, side / 2
                R = _leaning(across, sign * slope)
                p = R @ middle
                p[across] += sign * self.half_size[across]
                slabs.append(_slab(f"wall_{axis}_{name}", size, p, R))
        return tuple(slabs)


def _leaning(across: int, angle: float) -> np.ndarray:
    """Returns the (3, 3) turn of a wall that leans towards x, or towards y."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    R[across, across] = R[2, 2] = c
    R[across, 2], R[2, across] = s, -s
    return R


def _slab(
    name: str,
    size: list[float],
    p: np.ndarray | list[float],
    R: np.ndarray | None = None,
    *,
    seen: bool = True,
) -> Slab:
    """Rounds lengths to a nanometre, as a file of them would have them."""
    X = np.eye(4)
    X[:3, :3] = np.eye(3) if R is None else R
    X[:3, 3] = np.round(p, 9)
    return Slab(name, np.round(size, 9), X, seen)


@dataclass
class Bin(OpenBox):
    """The bin with the heap. Its frame is the world's (PROTOCOL.md, "Scene").

    Its floor is z = 0, and the world's origin is at the floor's middle.
    """


@dataclass
class Tote(OpenBox):
    """Where the gripper puts objects down: beside the bin, level with it."""

    length: float = number(0.36, "(0, 5]")
    width: float = number(0.36, "(0, 5]")
    wall_thickness: float = number(0.01, "(0, 0.5]")
    # Middle of its floor in the world, m; none stands for a place beside the
    # bin, along x.
    position: list[float] = number_list((), "[-5, 5]", (0, 3))

    def beside(self, bin_: Bin) -> Self:
        """Returns it at a place: its own, or else beside a bin.

        Raises:
            ConfigurationError: it stands in the bin.
        """
        apart = bin_.outside + self.outside
        if not self.position:
            x = round(float(apart[0]) + _GAP, 9)
            return replace(self, position=[x, 0.0, 0.0])
        if self.position[2] != 0:
            raise ConfigurationError(
                f"tote.position is {list(self.position)}: the tote stands "
                "level with the bin, so z must be 0"
            )
        if (np.abs(self.position[:2]) < apart).all():
            raise ConfigurationError(
                f"tote.position is {list(self.position)}: the tote stands in "
                f"the bin; keep it {apart[0]:.3g} m away along x, or "
                f"{apart[1]:.3g} m along y"
            )
        return self

    def place(self, p_W: np.ndarray) -> np.ndarray:
        """Returns a point (3,) of the world in the tote's frame, m."""
        return np.asarray(p_W) - self.position

    def is_under(self, p_W: np.ndarray) -> bool:
        """Says whether a point (3,) in the world is in the tote, or above."""
        return self.is_over(self.place(p_W))

    def holds(self, p_W: np.ndarray) -> bool:
        """Says whether a point (3,) in the world is in the tote, m."""
        p_B = self.place(p_W)
        return self.is_over(p_B) and bool(p_B[2] < self.wall_height)

    def slot(self, carried: int) -> np.ndarray:
        """Returns where the next object goes, (2,) in the world, m.

        Three rows of three, over and over.

        Args:
            carried: number of objects brought there before.
        """
        row, column = divmod(carried % 9, 3)
        step = np.array([self.length, self.width]) / 3.6
        return np.array(self.position[:2]) + np.round(
            step * [column - 1, 1 - row], 9
        )
