"""The cell: one description of what does not change from heap to heap."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.sensors import CameraConfig

from xray_drake.cell.bin import Bin, Tote
from xray_drake.cell.cameras import (
    LENS,
    camera_complaints,
    nominal_camera,
    pinhole_camera,
    sized,
)
from xray_drake.cell.drake_rules import DRAKE_RULES
from xray_drake.cell.gripper import CellGripper
from xray_drake.cell.names import cell_path
from xray_drake.configuration import (
    check,
    configured,
    differences,
    number_list,
    path_field,
    tree_of,
)
from xray_drake.trees import (
    ConfigurationError,
    read_text,
    read_tree,
    write_tree,
)

_HOME_BESIDE = 0.10
_HOME_ABOVE = 0.22
"""How far from the bin's outside, and over its walls, the jaw waits, m."""

_MOUNT_BESIDE = 0.01
_MOUNT_ABOVE = 0.48
"""How far from the bin's outside, and over its walls, an arm is mounted, m."""


_LEAST_SEEN = 0.25
"""Share of the bin's floor that the overhead camera must see."""


@dataclass(slots=True, eq=False)
class Cell:
    """Bin, tote, cameras, gripper.

    World z is up, the bin's floor is z = 0, the origin is at the middle of its
    inside.
    """

    # Name, for the record.
    name: str = "nominal"
    # The bin with the heap.
    bin: Bin = field(default_factory=Bin)
    # Where objects are put down.
    tote: Tote = field(default_factory=Tote)
    # The camera that the search looks through. Its images are rendered when
    # they are looked at: fps, rgb, depth and label say nothing here. Where a
    # size is given alone, focal length and centre follow it.
    overhead: CameraConfig = field(default_factory=nominal_camera)
    # Other cameras of the cell by their names: the station has their images.
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    # The gripper.
    gripper: CellGripper = field(default_factory=CellGripper)
    # Where it waits: position of the jaw in the world, m, pointing
    # down; none stands for beside the bin, along y, over its walls.
    home: list[float] = number_list((), "[-5, 5]", (0, 3))
    # Where the base of an arm is mounted in the world, m; none stands for over
    # the gap between bin and tote.
    mount: list[float] = number_list((), "[-5, 5]", (0, 3))
    # Drake model directives of what else stands in the cell.
    directives: str = path_field()

    def __eq__(self, other: object) -> bool:
        """Compares all values: Drake's structs have no equality."""
        if not isinstance(other, Cell):
            return NotImplemented
        return tree_of(self) == tree_of(other)

    def looks_nominal(self) -> bool:
        """Says whether bin and overhead camera are those of the nominal cell.

        What shipped networks have learned holds for these.
        """
        other = Cell()
        mine, usual = (pinhole_camera(c.overhead) for c in (self, other))
        return (
            self.bin == other.bin
            and mine.shape == usual.shape
            and np.allclose(mine.intrinsics, usual.intrinsics)
            and np.allclose(mine.X_WC, usual.X_WC)
        )

    @property
    def placed_tote(self) -> Tote:
        """The tote at its place in the world."""
        return self.tote.beside(self.bin)

    @property
    def X_WH(self) -> np.ndarray:
        """Pose of the jaw at home, 4×4, m: it points down."""
        X = np.diag([1.0, -1.0, -1.0, 1.0])
        beside = round(float(self.bin.outside[1]) + _HOME_BESIDE, 9)
        above = round(self.bin.wall_height + _HOME_ABOVE, 9)
        X[:3, 3] = self.home or [0.0, beside, above]
        return X

    @property
    def p_WM(self) -> np.ndarray:
        """Where the base of an arm is mounted, (3,) in the world, m."""
        beside = round(float(self.bin.outside[0]) + _MOUNT_BESIDE, 9)
        above = round(self.bin.wall_height + _MOUNT_ABOVE, 9)
        return np.array(self.mount or [beside, 0.0, above])

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its parts; a line each."""
        try:
            _ = self.placed_tote
        except ConfigurationError as error:
            yield str(error)
        if not self.overhead.name:
            yield "overhead.name is empty"
        said = ""
        for said in camera_complaints(self.overhead, self.bin.floor):
            yield f"overhead{said}"
        if not said:
            yield from self._unseen()
        for key, camera in self.cameras.items():
            for said in camera_complaints(camera):
                yield f"cameras.{key}{said}"
            if key == self.overhead.name:
                yield (
                    f"cameras.{key} has the name of the overhead camera: "
                    "choose another"
                )
            elif camera.name != key:
                yield (
                    f"cameras.{key}.name is {camera.name!r}: call it {key!r}"
                )

    def _unseen(self) -> Iterator[str]:
        """Yields what of the bin the overhead camera cannot see."""
        camera, floor = pinhole_camera(self.overhead), self.bin.floor
        if camera.X_WC[2, 3] <= self.bin.wall_height:
            yield (
                f"overhead is {camera.X_WC[2, 3]:.3g} m over the floor, and "
                f"the bin's walls are {self.bin.wall_height:g} m high: put the "
                "camera above them"
            )
            return
        x, y = (np.linspace(*side, 21) for side in (floor.x, floor.y))
        grid = np.stack(np.meshgrid(x, y, [0.0]), axis=-1).reshape(-1, 3)
        u, v, z = camera.project(grid).T
        seen = (z > 0) & (np.abs(u - (camera.width - 1) / 2) < camera.width / 2)
        seen &= np.abs(v - (camera.height - 1) / 2) < camera.height / 2
        if seen.mean() < _LEAST_SEEN:
            yield (
                f"overhead sees {seen.mean():.0%} of the bin's floor: move it "
                "away, shorten its focal length, or give a smaller bin"
            )


def load_cell(name_or_path: str | Path) -> Cell:
    """Reads a cell that comes with the package, or a file.

    Its paths hold in any folder.

    Raises:
        ConfigurationError: no such cell or file; not YAML; a key that does not
            exist, named with its path; a value that cannot be.
    """
    path = cell_path(name_or_path)
    return parse_cell(read_text(path), str(path), folder=path.parent)


def parse_cell(text: str, source: str, *, folder: Path | None = None) -> Cell:
    """Reads a cell from YAML text; see :func:`load_cell`.

    Args:
        text: YAML.
        source: where it came from, for messages.
        folder: what the paths in it are relative to; by default they are left
            as they are.

    Raises:
        ConfigurationError: as :func:`load_cell`.
    """
    tree = cell_tree(read_tree(text, source))
    cell = configured(Cell, tree, source, folder=folder, foreign=DRAKE_RULES)
    check(cell, source, DRAKE_RULES)
    return cell


def cell_tree(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the tree of a cell with all that follows from what it says.

    The focal length and the centre of a camera of which only the size is given
    follow it; cameras have their names.

    Args:
        tree: of :func:`~xray_drake.configuration.read_tree`; it is left as it
            is.
    """
    tree = dict(tree)
    if isinstance(tree.get("overhead"), dict):
        tree["overhead"] = sized(tree["overhead"])
    if isinstance(tree.get("cameras"), dict):
        tree["cameras"] = {
            name: {"name": name, **camera}
            if isinstance(camera, dict)
            else camera
            for name, camera in tree["cameras"].items()
        }
    return tree


def cell_differences(cell: Cell) -> dict[str, Any]:
    """Returns what a cell has that the nominal one has not, as keys and values.

    With the lens of a camera of another size, which else would follow that.
    """
    tree = tree_of(cell)
    kept = differences(tree, tree_of(Cell()))
    overhead = kept.get("overhead", {})
    if {"width", "height"} & set(overhead):
        overhead |= {key: tree["overhead"][key] for key in LENS}
    return kept


def dump_cell(cell: Cell) -> str:
    """Returns YAML that :func:`parse_cell` reads as the same cell."""
    return write_tree(cell_differences(cell))
