"""The gripper of a cell: its model, and what it can do."""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

from xray_drake.configuration import (
    ConfigurationError,
    check,
    number,
    path_or_name,
    required_number,
    rules_of,
)
from xray_drake.resources import models_dir
from xray_drake.trees import read_text, read_tree

SUFFIX = ".sdf"
"""Of a gripper's model file; a YAML beside it says what SDFormat cannot."""


@dataclass(frozen=True, kw_only=True)
class GripperSpec:
    """What a gripper can do; frames and shapes are in its model file.

    The model has bodies ``gripper_base``, ``left_finger`` and ``right_finger``,
    joints ``left_finger_joint`` and ``right_finger_joint``, a frame ``jaw``,
    and a frame ``cup`` if there is a suction cup: see ``yumi.sdf``.
    """

    # The SDFormat model.
    file: Path
    # Distance of the pads when open, m.
    opening: float = required_number("(0, 1]")
    # Largest normal force at each pad, N.
    force: float = required_number("(0, 1000]")
    # Coulomb coefficient of pads and cup.
    friction: float = required_number("(0, 5]")
    # Width and height of the pad at each fingertip, m.
    pad_width: float = required_number("(0, 0.1]")
    pad_height: float = required_number("(0, 0.1]")
    # How far the pad gives way, m: what is closer than this to the first point
    # of contact touches the pad too.
    pad_compliance: float = required_number("[0, 0.1]")
    # Radius of the suction cup's lip, m; 0 stands for no cup.
    cup_radius: float = number(0.0, "[0, 0.1]")
    # Largest pull of the vacuum, N.
    vacuum_force: float = number(0.0, "[0, 1000]")
    # Elastic constant κ of the lip in Dex-Net 3.0's model, N.
    cup_elasticity: float = number(0.0, "[0, 1000]")
    # What the bellows takes up along its axis, either way, m.
    bellows_travel: float = number(0.0, "[0, 0.1]")

    @property
    def has_cup(self) -> bool:
        """It has a suction cup."""
        return self.cup_radius > 0

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its fields."""
        for name in ("vacuum_force", "cup_elasticity", "bellows_travel"):
            value = getattr(self, name)
            if self.has_cup and value <= 0:
                yield (
                    f"{name} is {value}: a suction cup (cup_radius is "
                    f"{self.cup_radius}) needs more than 0"
                )


@dataclass(slots=True)
class CellGripper:
    """Which gripper a cell has."""

    # One of gripper_names(), or an SDFormat file with a YAML beside it.
    model: str = path_or_name("yumi", (SUFFIX,))
    # Fields of GripperSpec that are other than that YAML says.
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def spec(self) -> GripperSpec:
        """What the gripper can do.

        Raises:
            ConfigurationError: as :func:`load_gripper`.
        """
        return load_gripper(self.model, self.parameters)

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong with single parameters."""
        yield from _complaints(self.parameters, "parameters.")


def gripper_names() -> tuple[str, ...]:
    """Returns the names of the grippers that come with the package."""
    folder = models_dir() / "gripper"
    return tuple(sorted(path.stem for path in folder.glob("*.yaml")))


def gripper_path(name_or_path: str | Path) -> Path:
    """Returns the model file of a gripper.

    Args:
        name_or_path: a name of :func:`gripper_names`, or an SDFormat file.

    Raises:
        ConfigurationError: there is no such gripper.
    """
    path = Path(name_or_path).expanduser()
    if path.suffix.lower() == SUFFIX:
        if not path.is_file():
            raise ConfigurationError(f"no gripper: {path} is not there")
        return path.absolute()
    if str(name_or_path) not in gripper_names():
        raise ConfigurationError(
            f"no gripper {str(name_or_path)!r}: choose one of "
            f"{', '.join(gripper_names())}, or give an SDFormat file"
        )
    return models_dir() / "gripper" / f"{name_or_path}{SUFFIX}"


def load_gripper(
    name_or_path: str | Path = "yumi",
    overrides: Mapping[str, float] | None = None,
) -> GripperSpec:
    """Reads what a gripper can do from the YAML beside its model.

    Args:
        name_or_path: a name of :func:`gripper_names`, or an SDFormat file.
        overrides: fields that are other than the YAML says.

    Raises:
        ConfigurationError: no such gripper; a field that is missing, does not
            exist or cannot be, in one line.
    """
    file = gripper_path(name_or_path)
    source = file.with_suffix(".yaml")
    tree: dict[str, Any] = read_tree(read_text(source), str(source))
    overrides = overrides or {}
    for given, where in ((tree, str(source)), (overrides, f"{source} changed")):
        for said in _complaints(given, ""):
            raise ConfigurationError(f"{where}: {said}")
    values = {**tree, **overrides}
    for name in _FIELDS:
        if name not in values and name not in _OPTIONAL:
            raise ConfigurationError(f"{source}: {name} is missing")
    spec = GripperSpec(
        file=file, **{name: float(value) for name, value in values.items()}
    )
    check(spec, str(source))
    return spec


_FIELDS = tuple(f.name for f in fields(GripperSpec) if f.name != "file")
_OPTIONAL = {f.name for f in fields(GripperSpec) if f.default is not MISSING}
"""A gripper without a suction cup leaves these out."""


def _complaints(values: Mapping[str, Any], prefix: str) -> Iterator[str]:
    """Yields what is wrong with fields of a :class:`GripperSpec`."""
    rules = rules_of(GripperSpec)
    for name, value in values.items():
        if name not in _FIELDS:
            near = difflib.get_close_matches(str(name), _FIELDS, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            yield f"{prefix}{name} does not exist{hint}"
        elif said := rules[name].broken_by(value):
            yield f"{prefix}{name} is {value!r}: {said}"
