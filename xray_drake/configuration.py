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
import numbers
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np
import yaml

from xray_drake.ranges import Choice, Interval, Numbers, Rectangle, Rule

SEEDS = f"[0, {2**63 - 1}]"
"""Range of a seed: datasets keep them in 64 bits."""

BIN_FLOOR = (-0.25, 0.25, -0.20, 0.20)
"""Inside of the bin's floor: x low, x high, y low, y high, m (PROTOCOL.md)."""

_RULE = "rule"
_PATH = "path"

Config = TypeVar("Config")


class ConfigurationError(ValueError):
    """A configuration that cannot be used: where, which key, what to do."""


def number(default: float, interval: str) -> Any:
    """A field of a dataclass: a number.

    Args:
        default: its default.
        interval: what it may be, e.g. "(0, 1]".
    """
    return _ruled(Interval.of(interval), default)


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


def bin_floor() -> Any:
    """A field of a dataclass: x low, x high, y low, y high of a floor, m.

    The default is :data:`BIN_FLOOR`.
    """
    return field(
        default_factory=lambda: list(BIN_FLOOR),
        metadata={_RULE: Rectangle()},
    )


def path_field() -> Any:
    """A field of a dataclass: a path, or "" for none."""
    return field(default="", metadata={_PATH: True})


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
        elif rule is not None:
            if said := rule.broken_by(value):
                yield f"{path} is {_shown(value)}: {said}"
        elif isinstance(value, float | np.ndarray) and not (
            np.isfinite(value).all()
        ):
            yield f"{path} is {_shown(value)}: it must be finite"


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
        if f.metadata.get(_PATH):
            changed[f.name] = (
                [_absolute(path, folder) for path in value]
                if isinstance(value, list)
                else _absolute(value, folder)
            )
        elif dataclasses.is_dataclass(value):
            changed[f.name] = with_paths(value, folder)
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


def read_text(path: Path) -> str:
    """Reads a file.

    Raises:
        ConfigurationError: it cannot be read, or is no text.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read {path}: {error}") from error


def read_tree(text: str, source: str) -> dict[str, Any]:
    """Reads YAML whose top level is keys and values.

    Numbers are those of YAML 1.2: 1e-3 is one, 1:30 and 010 are text.

    Args:
        text: YAML; empty text holds no keys.
        source: what a message begins with, e.g. the file.

    Returns:
        Mappings, lists, strings, numbers, booleans and ``None``; a mapping
        with a tag has it under the key "_tag".

    Raises:
        ConfigurationError: it is not YAML, a key stands twice, or its top
            level is something else.
    """
    try:
        tree = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        where = " ".join(str(error).split())
        raise ConfigurationError(f"{source} is not YAML: {where}") from error
    if tree is None:
        return {}
    if not isinstance(tree, dict) or "_tag" in tree:
        kind = tree["_tag"] if isinstance(tree, dict) else type(tree).__name__
        raise ConfigurationError(
            f"{source}: its top level must be keys and values, not {kind}"
        )
    return tree


def write_tree(tree: Mapping[str, Any]) -> str:
    """Returns YAML that :func:`read_tree` reads as it was."""
    return yaml.dump(
        tree,
        Dumper=_Dumper,
        default_flow_style=None,
        sort_keys=False,
    )


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


def build(schema: type[Config], tree: Mapping[str, Any]) -> Config:
    """Makes a dataclass of a tree that :func:`check_tree` has found right."""
    kinds = fields_of(schema)
    return schema(**{k: _built(kinds[k], v) for k, v in tree.items()})


def _built(kind: Any, value: Any) -> Any:
    if dataclasses.is_dataclass(kind):
        return build(typing.cast(type, kind), value)
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


class _Resolver:
    """YAML 1.2's numbers, and no dates."""

    yaml_implicit_resolvers: typing.ClassVar[dict] = {}


for _first, _tags in yaml.SafeLoader.yaml_implicit_resolvers.items():
    _Resolver.yaml_implicit_resolvers[_first] = [
        (tag, pattern)
        for tag, pattern in _tags
        if tag.rsplit(":", 1)[-1] not in ("int", "float", "timestamp")
    ]
for _name, _pattern, _starts in (
    ("int", r"[-+]?(0|[1-9][0-9_]*)$|0x[0-9a-fA-F]+$", "-+0123456789"),
    (
        "float",
        r"[-+]?(\d[\d_]*\.\d*|\.\d+|\d+(?=[eE]))([eE][-+]?\d+)?$"
        r"|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$",
        "-+0123456789.",
    ),
):
    for _first in _starts:
        _Resolver.yaml_implicit_resolvers.setdefault(_first, []).append(
            (f"tag:yaml.org,2002:{_name}", re.compile(_pattern))
        )


class _Loader(yaml.SafeLoader):
    """Rejects duplicate keys, which YAML readers accept silently."""

    yaml_implicit_resolvers = _Resolver.yaml_implicit_resolvers

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict:
        keys = [self.construct_object(key, deep=deep) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands twice", node.start_mark
                )
        return super().construct_mapping(node, deep=deep)


def _construct_tagged(loader: _Loader, tag: str, node: yaml.Node) -> dict:
    """Reads ``!Rpy {…}``: tags are Drake's."""
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(
            None, None, f"!{tag} must tag keys and values", node.start_mark
        )
    return {**loader.construct_mapping(node, deep=True), "_tag": f"!{tag}"}


_Loader.add_multi_constructor("!", _construct_tagged)


class _Dumper(yaml.SafeDumper):
    """Writes plainly what :class:`_Loader` reads as the same."""

    yaml_implicit_resolvers = _Resolver.yaml_implicit_resolvers

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_mapping(dumper: _Dumper, data: Mapping) -> yaml.Node:
    tree = {key: value for key, value in data.items() if key != "_tag"}
    return dumper.represent_mapping(
        data.get("_tag", "tag:yaml.org,2002:map"), tree
    )


_Dumper.add_representer(dict, _represent_mapping)
