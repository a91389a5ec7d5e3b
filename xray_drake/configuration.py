"""Configurations: dataclasses, read from YAML, with a range for every number.

What a field may be stands where it is defined::

    @dataclass
    class Motion:
        # Highest speed, m/s.
        speed: float = number(0.8, "(0, 10]")
        # Looks at the heap within a round.
        looks: int = count(3, "[1, 100]")
        # How it moves.
        kind: str = choice("straight", ("straight", "curved"))

:func:`check` tells which field of a configuration is wrong, nested ones too.
:func:`read_tree` and :func:`check_tree` read YAML without guessing: no key
twice, none that does not exist, no value of another type.
"""

import dataclasses
import difflib
import itertools
import numbers
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np

from xray_drake.ranges import Choice, Interval, Numbers, Rule
from xray_drake.trees import (
    ConfigurationError,
)

SEEDS = f"[0, {2**63 - 1}]"
"""Range of a seed: datasets keep them in 64 bits."""

_RULE = "rule"
_PATH = "path"

Config = TypeVar("Config")


def number(default: float, interval: str) -> Any:
    """A field of a dataclass: a number.

    Args:
        default: its default.
        interval: what it may be, e.g. "(0, 1]".
    """
    return _ruled(Interval.of(interval), default)


def required_number(interval: str) -> Any:
    """A field of a dataclass: a number that must be given."""
    return field(metadata={_RULE: Interval.of(interval)})


def count(default: int, interval: str) -> Any:
    """A field of a dataclass: a whole number; see :func:`number`."""
    return _ruled(Interval.of(interval, whole=True), default)


def choice(default: str, names: Sequence[str]) -> Any:
    """A field of a dataclass: one of some names."""
    return _ruled(Choice(tuple(names)), default)


def number_list(
    default: Sequence[float], interval: str, lengths: Sequence[int]
) -> Any:
    """A field of a dataclass: a list of numbers.

    Args:
        default: its default.
        interval: what each of the numbers may be.
        lengths: how many there may be.
    """
    rule = Numbers(Interval.of(interval), tuple(lengths))
    return field(default_factory=lambda: list(default), metadata={_RULE: rule})


def path_field() -> Any:
    """A field of a dataclass: a path, or "" for none."""
    return field(default="", metadata={_PATH: True})


def path_or_name(default: str, suffixes: Sequence[str]) -> Any:
    """A field of a dataclass: text that is a path if it ends as a file does.

    Args:
        default: its default.
        suffixes: of files, lower case, as in ".stl".
    """
    return field(default=default, metadata={_PATH: tuple(suffixes)})


def path_list() -> Any:
    """A field of a dataclass: paths."""
    return field(default_factory=list, metadata={_PATH: True})


def _ruled(rule: Rule, default: Any) -> Any:
    if said := rule.broken_by(default):
        raise ValueError(f"the default is {default}: {said}")
    return field(default=default, metadata={_RULE: rule})


Rules = Mapping[str, Mapping[str, Rule]]
"""Name of a class that is no dataclass (one of Drake's) to its fields'."""


def is_struct(schema: Any) -> bool:
    """Says whether it is a dataclass or one of Drake's structs, or of one."""
    return dataclasses.is_dataclass(schema) or hasattr(schema, "__fields__")


def fields_of(schema: Any) -> dict[str, Any]:
    """Returns name and type of each field of a dataclass or Drake struct."""
    if dataclasses.is_dataclass(schema):
        hints = typing.get_type_hints(schema)
        return {f.name: hints[f.name] for f in dataclasses.fields(schema)}
    return {f.name: f.type for f in getattr(schema, "__fields__", ())}


def rules_of(schema: type, foreign: Rules | None = None) -> Mapping[str, Rule]:
    """Returns the rules of a class's fields.

    Args:
        schema: a dataclass or one of Drake's structs.
        foreign: the rules of the latter.
    """
    if dataclasses.is_dataclass(schema):
        return {
            f.name: f.metadata[_RULE]
            for f in dataclasses.fields(schema)
            if _RULE in f.metadata
        }
    return (foreign or {}).get(schema.__qualname__, {})


def check(config: Any, source: str, foreign: Rules | None = None) -> None:
    """Checks all fields of a configuration, nested ones too.

    A dataclass that has a method ``complaints`` is asked for what is wrong
    between its fields: it yields lines that begin with a field.

    Args:
        config: a dataclass, which may hold structs of Drake's.
        source: what the message begins with, e.g. the file.
        foreign: rules for the fields of Drake's structs.

    Raises:
        ConfigurationError: one line that names the first field that is wrong.
    """
    for said in _complaints(config, "", foreign):
        raise ConfigurationError(f"{source}: {said}")


def _complaints(
    config: Any, prefix: str, foreign: Rules | None
) -> Iterator[str]:
    rules = rules_of(type(config), foreign)
    for name, kind in fields_of(type(config)).items():
        value = _value(config, name)
        path, rule = f"{prefix}{name}", rules.get(name)
        if value is None and type(None) in typing.get_args(kind):
            continue
        if is_struct(value):
            yield from _complaints(value, f"{path}.", foreign)
        elif isinstance(value, dict):
            for key, item in value.items():
                if is_struct(item):
                    yield from _complaints(item, f"{path}.{key}.", foreign)
        elif _holds_configurations(value):
            for index, item in enumerate(value):
                yield from _complaints(item, f"{path}[{index}].", foreign)
        elif rule is not None:
            if said := rule.broken_by(value):
                yield f"{path} is {_shown(value)}: {said}"
        elif isinstance(value, float | np.ndarray) and not (
            np.isfinite(value).all()
        ):
            yield f"{path} is {_shown(value)}: it must be finite"
    for said in getattr(config, "complaints", tuple)():
        yield f"{prefix}{said}"


def _holds_configurations(value: Any) -> bool:
    """Says whether it is a list of dataclasses."""
    return isinstance(value, list) and any(map(dataclasses.is_dataclass, value))


def in_order(config: Any, *names: str) -> Iterator[str]:
    """Yields what is wrong where fields must rise, for ``complaints``.

    Args:
        config: has the fields.
        names: of fields, none greater than the next.
    """
    for low, high in itertools.pairwise(names):
        least, most = _value(config, low), _value(config, high)
        if least > most:
            yield f"{low} is {least}: it must be at most {most}, {high}"


def _shown(value: Any) -> str:
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(map(str, value))}]"
    return repr(value) if isinstance(value, str) else str(value)


def _value(config: Any, name: str) -> Any:
    """Drake's Transform and others have keys that are not attributes."""
    rewrite = getattr(config, "_rewrite_yaml_dump_attr_name", None)
    return getattr(config, rewrite(name) if rewrite else name)


def with_paths(config: Config, folder: Path) -> Config:
    """Returns a configuration in which every path is absolute.

    Args:
        config: a dataclass; it is left as it is.
        folder: what its paths are relative to.
    """
    changed: dict[str, Any] = {}
    for f in dataclasses.fields(config):  # type: ignore[arg-type]
        value = getattr(config, f.name)
        suffixes = f.metadata.get(_PATH)
        if isinstance(suffixes, tuple):
            if Path(value).suffix.lower() in suffixes:
                changed[f.name] = _absolute(value, folder)
        elif suffixes:
            changed[f.name] = (
                [_absolute(path, folder) for path in value]
                if isinstance(value, list)
                else _absolute(value, folder)
            )
        elif dataclasses.is_dataclass(value):
            changed[f.name] = with_paths(value, folder)
        elif _holds_configurations(value):
            changed[f.name] = [with_paths(item, folder) for item in value]
    return dataclasses.replace(config, **changed)  # type: ignore[type-var]


def _absolute(path: str, folder: Path) -> str:
    """Returns a path that holds in any folder; "" stands for none."""
    return str(folder.absolute() / Path(path).expanduser()) if path else ""


def tree_of(config: Any) -> dict[str, Any]:
    """Returns all that a configuration holds, as :func:`read_tree` reads it.

    Args:
        config: a dataclass, or one of Drake's structs.
    """
    return {
        name: _tree_of(_value(config, name), kind)
        for name, kind in fields_of(type(config)).items()
    }


def _tree_of(value: Any, kind: Any) -> Any:
    if value is None:
        return None
    if is_struct(value):
        tree = tree_of(value)
        others = [] if isinstance(kind, type) else typing.get_args(kind)[1:]
        if type(value) in others:
            tree["_tag"] = _tag(type(value))
        return tree
    if isinstance(value, list | tuple):
        return [_tree_of(item, type(item)) for item in value]
    if isinstance(value, dict):
        return {key: _tree_of(item, type(item)) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return float(value) if kind is float else value


def differences(tree: dict[str, Any], defaults: dict[str, Any]) -> dict:
    """Returns what a tree has that the defaults have not.

    What stands under a tag is kept as a whole.
    """
    kept = {}
    for key, value in tree.items():
        default: Any = defaults.get(key)
        if key in defaults and value == default:
            continue
        if _is_plain(value) and _is_plain(default):
            value = differences(value, default)
        kept[key] = value
    return kept


def _is_plain(part: Any) -> TypeGuard[dict[str, Any]]:
    """Says whether it is keys and values without a tag."""
    return isinstance(part, dict) and bool(part) and "_tag" not in part


def check_tree(
    tree: Mapping[str, Any],
    schema: type,
    source: str,
    foreign: Rules | None = None,
) -> None:
    """Checks keys, types and ranges before a configuration is made of a tree.

    Args:
        tree: of :func:`read_tree`.
        schema: a dataclass, which may hold Drake's structs.
        source: what a message begins with, e.g. the file.
        foreign: rules for the fields of Drake's structs.

    Raises:
        ConfigurationError: one line that names a key that does not exist, or
            whose value is of another type or out of range.
    """
    for said in _strange(tree, schema, "", foreign):
        raise ConfigurationError(f"{source}: {said}")


def configured(
    schema: type[Config],
    tree: Mapping[str, Any],
    source: str,
    *,
    folder: Path | None = None,
    foreign: Rules | None = None,
) -> Config:
    """Makes a dataclass of a tree: :func:`check_tree`, then :func:`build`.

    Args:
        schema: a dataclass, which may hold Drake's structs.
        tree: of :func:`~xray_drake.trees.read_tree`.
        source: what a message begins with, e.g. the file.
        folder: what its paths are relative to; by default they are left as
            they are.
        foreign: rules for the fields of Drake's structs.

    Raises:
        ConfigurationError: as those two.
    """
    check_tree(tree, schema, source, foreign)
    config = build(schema, tree, source)
    return config if folder is None else with_paths(config, folder)


def build(schema: type[Config], tree: Mapping[str, Any], source: str) -> Config:
    """Makes a dataclass of a tree that :func:`check_tree` has found right.

    What is left out has the dataclass's default; of a Drake struct as well,
    field by field.

    Args:
        schema: a dataclass, which may hold Drake's structs.
        tree: keys and values.
        source: what a message begins with, e.g. the file.

    Raises:
        ConfigurationError: Drake cannot make its struct of a part of the tree.
    """
    kinds, made = fields_of(schema), {}
    for f in dataclasses.fields(schema):  # type: ignore[arg-type]
        if f.name in tree:
            default = None
            if f.default_factory is not dataclasses.MISSING:
                default = f.default_factory()
            made[f.name] = _built(
                kinds[f.name], tree[f.name], f"{source}: {f.name}", default
            )
    return schema(**made)


def build_struct(
    kind: Any, tree: Mapping[str, Any], source: str, defaults: Any = None
) -> Any:
    """Makes one of Drake's structs of a tree; see :func:`build`.

    Args:
        kind: of the struct.
        tree: keys and values.
        source: what a message begins with, e.g. the file.
        defaults: a struct that has what the tree has not; it is left as it is.
    """
    from pydrake.common.yaml import yaml_dump, yaml_load_typed

    try:
        return yaml_load_typed(
            schema=kind, data=yaml_dump(tree), defaults=defaults
        )
    except Exception as error:
        said = " ".join(str(error).split())
        raise ConfigurationError(f"{source}: {said}") from error


def _built(kind: Any, value: Any, source: str, default: Any = None) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if value is None:
        return None
    if dataclasses.is_dataclass(kind):
        return build(typing.cast(type, kind), value, source)
    if is_struct(kind):
        return build_struct(kind, value, source, default)
    if origin is list:
        return [_built(arguments[0], item, source) for item in value]
    if origin is dict:
        return {
            key: _built(arguments[1], item, f"{source}.{key}")
            for key, item in value.items()
        }
    return float(value) if kind is float else value


_SCALARS: dict[Any, tuple[type, str]] = {
    int: (int, "a whole number"),
    float: (numbers.Real, "a number"),
    bool: (bool, "true or false"),
    str: (str, "text"),
}


def _strange(
    value: Any, kind: Any, path: str, foreign: Rules | None
) -> Iterator[str]:
    """Yields what is not of a type, with its path."""
    is_ = f"{path} is {_shown(value)}"
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in arguments:
            return
        tag = value.get("_tag") if isinstance(value, dict) else None
        chosen = next((k for k in arguments if tag == _tag(k)), None)
        if tag is not None and chosen is None:
            yield f"{path} is tagged {tag}, which does not exist"
        else:
            yield from _strange(value, chosen or arguments[0], path, foreign)
    elif kind in _SCALARS:
        wanted, name = _SCALARS[kind]
        wrong = isinstance(value, bool) and kind is not bool
        if wrong or not isinstance(value, wanted):
            yield f"{is_}: it must be {name}"
    elif origin is list or kind is np.ndarray:
        each = arguments[0] if arguments else float
        if not isinstance(value, list):
            yield f"{is_}: it must be a list"
            return
        for index, item in enumerate(value):
            yield from _strange(item, each, f"{path}[{index}]", foreign)
    elif origin is dict:
        if not isinstance(value, dict):
            yield f"{is_}: it must be keys and values"
            return
        for key, item in value.items():
            if arguments[1] is not Any:
                yield from _strange(
                    item, arguments[1], f"{path}.{key}", foreign
                )
    elif is_struct(kind):
        if not isinstance(value, dict):
            yield f"{is_}: it must be keys and values"
            return
        kinds, rules = fields_of(kind), rules_of(kind, foreign)
        prefix = f"{path}." if path else ""
        for key, item in value.items():
            name = f"{prefix}{key}"
            if key in kinds:
                said = list(_strange(item, kinds[key], name, foreign))
                yield from said
                if not said and item is not None and key in rules:
                    said_of = rules[key].broken_by(item)
                    if said_of and not isinstance(item, dict):
                        yield f"{name} is {_shown(item)}: {said_of}"
            elif key != "_tag":
                near = difflib.get_close_matches(str(key), kinds, 1)
                hint = f"; did you mean {prefix}{near[0]}?" if near else ""
                yield f"unknown key {name}{hint}"


def _tag(kind: Any) -> str:
    """Returns the tag of one of Drake's structs: its name, without the size."""
    return "!" + re.split(r"\W|𝓣", getattr(kind, "__name__", ""))[0]
