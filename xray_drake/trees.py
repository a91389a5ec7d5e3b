"""YAML read without guessing: no key twice, numbers as in YAML 1.2."""

import re
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml


class ConfigurationError(ValueError):
    """A configuration that cannot be used: where, which key, what to do."""


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
