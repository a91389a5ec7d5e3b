"""Weights of a network in one file, with a card that says where they are from.

The file is safetensors: numbers and text, so that reading it runs no code. The
card is JSON in the file's metadata, under one key.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
import yaml
from safetensors import SafetensorError, safe_open
from torch import Tensor

from xray_drake import __version__
from xray_drake.files import write_whole_file

FORMAT_VERSION = 1
"""Of the card."""

METADATA_KEY = "xray_drake"
"""Of the card in the metadata of the safetensors file."""

INPUTS = ("geometry", "augmented_depth")
"""What a network can be fed."""

_TRAIN = "make weights with 'xray-drake train'"
_AGAIN = "copy or export it again"


class WeightsError(ValueError):
    """Weights that cannot be used: what, where, what to do."""


@dataclass(frozen=True)
class NetworkCard:
    """What a network is, and what it was trained on.

    The mappings are kept as JSON gives them back: tuples become lists, keys
    become strings, and NaN, which JSON has not, becomes None.

    Attributes:
        architecture: name of the network's class.
        options: arguments of its constructor.
        input: one of :data:`INPUTS`.
        targets: names of the targets that it was trained on.
        box_size: length, width and thickness of the one box that it was
            trained on, m; None where it is told the target's size.
        data: the datasets: scenario, seed, images, heaps.
        training: epochs, seed, learning rate and the like.
        figures: what it reaches, on what.
        format_version: of the card.
        package_version: of the ``xray_drake`` that trained it.
        notes: whatever else a user should know.

    Raises:
        ValueError: a field cannot be what it is.
    """

    architecture: str
    options: Mapping[str, Any]
    input: str
    targets: tuple[str, ...]
    box_size: tuple[float, float, float] | None
    data: Mapping[str, Any] = field(default_factory=dict)
    training: Mapping[str, Any] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)
    format_version: int = FORMAT_VERSION
    package_version: str = __version__
    notes: str = ""

    def __post_init__(self) -> None:
        for name in ("architecture", "input", "package_version", "notes"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"{name} is {getattr(self, name)!r}, no text")
        if not self.architecture:
            raise ValueError("architecture is empty")
        if self.input not in INPUTS:
            raise ValueError(
                f"input is {self.input!r}, not one of {', '.join(INPUTS)}"
            )
        if self.format_version != FORMAT_VERSION:
            raise ValueError(
                f"format_version is {self.format_version!r}, not "
                f"{FORMAT_VERSION}"
            )
        object.__setattr__(self, "targets", _names(self.targets))
        object.__setattr__(self, "box_size", _box_size(self.box_size))
        for name in ("options", "data", "training", "figures"):
            tree = getattr(self, name)
            if not isinstance(tree, Mapping):
                raise ValueError(f"{name} is {tree!r}, no mapping")
            object.__setattr__(self, name, _as_json(tree, name))

    def to_json(self) -> str:
        """Returns the card as :meth:`from_json` takes it."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "NetworkCard":
        """Reads a card.

        Raises:
            WeightsError: its format is newer than this package.
            ValueError: it is no JSON, or a field is missing, unknown or wrong;
                the message says which.
        """
        try:
            tree = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"it is no JSON: {error}") from error
        if not isinstance(tree, dict):
            raise ValueError(f"it is a {type(tree).__name__}, no mapping")
        version = tree.get("format_version")
        if type(version) is int and version > FORMAT_VERSION:
            raise WeightsError(
                f"it has format version {version}; this xray-drake "
                f"({__version__}) reads {FORMAT_VERSION}: upgrade xray-drake"
            )
        known = {f.name for f in dataclasses.fields(cls)}
        if missing := sorted(known - tree.keys()):
            raise ValueError(f"it lacks {', '.join(missing)}")
        if unknown := sorted(tree.keys() - known):
            raise ValueError(f"it has unknown fields {', '.join(unknown)}")
        return cls(**tree)

    def to_markdown(self) -> str:
        """Returns the card as a page to read: name, notes, and YAML."""
        tree = json.loads(self.to_json())
        parts = [f"# {tree.pop('architecture')}", tree.pop("notes")]
        tree["box_size"] = tree["box_size"] or "any; it is told the size"
        text = yaml.safe_dump(
            tree, sort_keys=False, allow_unicode=True, default_flow_style=None
        )
        parts.append(f"```yaml\n{text}```")
        return "\n\n".join(part for part in parts if part) + "\n"


def save_weights(
    path: Path,
    state: Mapping[str, Tensor],
    card: NetworkCard,
    *,
    half: bool = False,
) -> None:
    """Writes weights and card, completely or not at all.

    The same arguments give the same bytes.

    Args:
        path: of the file; replaced if it exists.
        state: the network's ``state_dict()``, on any device.
        card: of the network.
        half: store float16, at half the size and three digits of precision;
            otherwise float32. Integers stay what they are.

    Raises:
        WeightsError: a weight is not finite, or too large for float16.
        OSError: it cannot be written; nothing is left over.
    """
    dtype = torch.float16 if half else torch.float32
    stored = {}
    for name, tensor in state.items():
        _check_finite(tensor, name, f"{path} is not written")
        # Each a copy of its own: safetensors takes no shared memory.
        copy = torch.empty(
            tensor.shape, dtype=dtype if _is_float(tensor) else tensor.dtype
        )
        stored[name] = copy.copy_(tensor.detach())
        if _is_float(tensor) and not torch.isfinite(copy).all():
            raise WeightsError(
                f"{path} is not written: weights {name!r} reach "
                f"{tensor.abs().max():.3g}, too large for {dtype}"
                + ("; save them with half=False" if half else "")
            )
    metadata = {METADATA_KEY: card.to_json()}
    write_whole_file(Path(path), safetensors.torch.save(stored, metadata))


def load_weights(path: Path) -> tuple[dict[str, Tensor], NetworkCard]:
    """Reads weights and card.

    Args:
        path: of a file of :func:`save_weights`.

    Returns:
        The state dict (name to tensor, of the network's shapes), on the CPU,
        floats as float32; and the card.

    Raises:
        WeightsError: there is no such file, it is damaged, it is none of ours,
            or a weight is not finite.
        OSError: it cannot be read at all.
    """
    card = read_card(path)
    state = {}
    with safe_open(path, framework="pt") as file:
        # Not a mapping: it has keys(), but cannot be iterated over.
        for name in file.keys():  # noqa: SIM118
            mapped = file.get_tensor(name)
            dtype = torch.float32 if _is_float(mapped) else mapped.dtype
            # A copy: what is mapped changes when the file is written over.
            tensor = mapped.to(dtype, copy=True)
            _check_finite(tensor, name, f"{path} is damaged")
            state[name] = tensor
    return state, card


def read_card(path: Path) -> NetworkCard:
    """Reads the card and leaves the weights unread.

    Raises:
        WeightsError: there is no such file, it is damaged, or none of ours.
        OSError: it cannot be read at all.
    """
    path = Path(path)
    if path.is_dir():
        raise WeightsError(
            f"{path} is a folder: name the file of weights in it"
        )
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except (FileNotFoundError, NotADirectoryError):
        raise WeightsError(
            f"there are no weights at {path}: check the path, or {_TRAIN}"
        ) from None
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except SafetensorError as error:
        raise WeightsError(_why_not(path, head, error)) from error
    if METADATA_KEY not in metadata:
        raise WeightsError(
            f"{path} is not from xray-drake: it has no model card "
            f"({METADATA_KEY!r} in its metadata); {_TRAIN}"
        )
    try:
        return NetworkCard.from_json(metadata[METADATA_KEY])
    except WeightsError as error:
        raise WeightsError(f"{path}: model card: {error}") from error
    except ValueError as error:
        raise WeightsError(f"{path}: model card: {error}; {_AGAIN}") from error


def _why_not(path: Path, head: bytes, error: SafetensorError) -> str:
    """Says why a file is not whole safetensors, from its first bytes."""
    if not head:
        return f"{path} is empty: {_AGAIN}"
    # Safetensors begin with the length of their header, which is JSON.
    if head[8:9] == b"{" and head[4:8] == bytes(4):
        return f"{path} is truncated or damaged: {_AGAIN} ({error})"
    if head[:2] == b"PK" or head[0] == 0x80:
        return (
            f"{path} is a pickle (torch.save), not safetensors; this package "
            f"never unpickles: {_TRAIN}"
        )
    return f"{path} is not safetensors: {_TRAIN} ({error})"


def _is_float(tensor: Tensor) -> bool:
    return tensor.dtype.is_floating_point


def _check_finite(tensor: Tensor, name: str, what: str) -> None:
    if _is_float(tensor) and not torch.isfinite(tensor).all():
        count = int((~torch.isfinite(tensor)).sum())
        raise WeightsError(
            f"{what}: {count} of {tensor.numel()} weights {name!r} are NaN or "
            "infinite; train again, with a lower learning rate, or use an "
            "earlier checkpoint"
        )


def _names(targets: object) -> tuple[str, ...]:
    if not isinstance(targets, list | tuple) or not all(
        isinstance(name, str) for name in targets
    ):
        raise ValueError(f"targets is {targets!r}, no list of names")
    return tuple(targets)


def _box_size(size: Any) -> tuple[float, float, float] | None:
    if size is None:
        return None
    try:
        length, width, thickness = (float(side) for side in size)
    except (TypeError, ValueError):
        raise ValueError(f"box_size is {size!r}, not three lengths") from None
    if not all(
        math.isfinite(side) and side > 0 for side in (length, width, thickness)
    ):
        raise ValueError(f"box_size is {size!r}: all must be above 0")
    return length, width, thickness


def _as_json(tree: Any, name: str) -> Any:
    """Returns a tree as it would come back from JSON."""
    if hasattr(tree, "tolist"):  # of NumPy or torch
        tree = tree.tolist()
    if isinstance(tree, Mapping):
        return {str(k): _as_json(v, f"{name}.{k}") for k, v in tree.items()}
    if isinstance(tree, list | tuple):
        return [_as_json(v, f"{name}.{i}") for i, v in enumerate(tree)]
    if tree is None or isinstance(tree, str | bool | int):
        return tree
    if isinstance(tree, float) and not math.isinf(tree):
        return None if math.isnan(tree) else tree
    raise ValueError(f"{name} is {tree!r}, which JSON cannot hold")
