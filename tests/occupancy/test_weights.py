import dataclasses
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from tests.disk import full_disk
from xray_drake.occupancy.learned.weights import (
    FORMAT_VERSION,
    INPUTS,
    METADATA_KEY,
    NetworkCard,
    WeightsError,
    load_weights,
    read_card,
    save_weights,
)

_CARD = NetworkCard(
    architecture="CompactNet",
    options={"widths": (24, 48), "in_channels": 5},
    input="geometry",
    targets=("box_1to1", "box_2to1"),
    box_size=None,
    data={"datasets": [{"scenario": "paper", "seed": 10000, "images": 12000}]},
    training={"epochs": 40, "learning rate": 1e-5, "flip": True},
    figures={"test": {"box_1to1": {"balanced_accuracy": 0.98, "iou": 0.91}}},
    notes="A first | try.",
)


def _state() -> dict[str, Tensor]:
    torch.manual_seed(0)
    network = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
    return network.state_dict()


def _save(path: Path, **change: Any) -> Path:
    """Weights of ours, with some fields of the card's JSON changed."""
    tree = {**json.loads(_CARD.to_json()), **change}
    return _save_text(path, json.dumps(tree))


def _save_text(path: Path, text: str) -> Path:
    path.write_bytes(safetensors.torch.save(_state(), {METADATA_KEY: text}))
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "network.safetensors"


def test_weights_and_card_come_back(path: Path) -> None:
    state = _state()
    save_weights(path, state, _CARD)
    loaded, card = load_weights(path)
    assert card == _CARD == read_card(path)
    assert loaded.keys() == state.keys()
    for name, tensor in state.items():
        assert loaded[name].dtype == tensor.dtype
        assert torch.equal(loaded[name], tensor)
    first = path.read_bytes()
    save_weights(path, state, _CARD)
    assert path.read_bytes() == first


def test_half_the_bytes_are_enough(path: Path) -> None:
    state = {
        "w": torch.randn(100, 100, dtype=torch.float64),
        "n": torch.ones(3),
    }
    save_weights(path, state, _CARD)
    full = path.stat().st_size
    assert load_weights(path)[0]["w"].dtype == torch.float32
    save_weights(path, state, _CARD, half=True)
    assert path.stat().st_size < 0.6 * full
    loaded = load_weights(path)[0]["w"]
    assert loaded.dtype == torch.float32
    torch.testing.assert_close(loaded, state["w"].float(), rtol=1e-3, atol=1e-6)


def test_tied_and_transposed_weights_are_saved(path: Path) -> None:
    tensor = torch.randn(3, 5)
    save_weights(path, {"a": tensor, "b": tensor, "c": tensor.T}, _CARD)
    loaded, _ = load_weights(path)
    assert torch.equal(loaded["a"], tensor)
    assert torch.equal(loaded["b"], tensor)
    assert torch.equal(loaded["c"], tensor.T)


def test_loaded_weights_outlive_their_file(path: Path) -> None:
    save_weights(path, {"w": torch.zeros(1000)}, _CARD)
    loaded, _ = load_weights(path)
    with path.open("r+b") as file:
        file.seek(-400, 2)
        file.write(b"\x3f" * 400)
    assert not loaded["w"].any()
    assert load_weights(path)[0]["w"].any()


def test_a_full_disk_leaves_the_old_weights(path: Path) -> None:
    save_weights(path, _state(), _CARD)
    first = path.read_bytes()
    with full_disk(100), pytest.raises(OSError):
        save_weights(path, {"w": torch.zeros(1000)}, _CARD)
    assert path.read_bytes() == first
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_the_card_is_read_alone(path: Path) -> None:
    data = safetensors.torch.save(
        {"w": torch.tensor([1.0, torch.nan, torch.inf])},
        {METADATA_KEY: _CARD.to_json()},
    )
    path.write_bytes(data)
    assert read_card(path) == _CARD
    with pytest.raises(
        WeightsError,
        match=r"network\.safetensors is damaged: 2 of 3 weights 'w' are NaN",
    ):
        load_weights(path)


def test_only_numbers_are_saved(path: Path) -> None:
    with pytest.raises(WeightsError, match="not written: 1 of 2 weights 'w'"):
        save_weights(path, {"w": torch.tensor([1.0, torch.nan])}, _CARD)
    large = {"w": torch.tensor([1.0, -1e5])}
    with pytest.raises(WeightsError, match=r"reach 1e\+05.*half=False"):
        save_weights(path, large, _CARD, half=True)
    assert not path.exists()
    save_weights(path, large, _CARD)


def _pickles() -> dict[str, bytes]:
    new, old = io.BytesIO(), io.BytesIO()
    torch.save(_state(), new)
    torch.save(_state(), old, _use_new_zipfile_serialization=False)
    return {
        "torch.save": new.getvalue(),
        "old torch.save": old.getvalue(),
        "pickle": pickle.dumps({"w": [1.0, 2.0]}),
    }


@pytest.mark.parametrize("kind", ["torch.save", "old torch.save", "pickle"])
def test_nothing_is_unpickled(path: Path, kind: str) -> None:
    path.write_bytes(_pickles()[kind])
    with pytest.raises(
        WeightsError, match=r"never unpickles.*xray-drake train"
    ):
        load_weights(path)


@pytest.mark.parametrize("keep", [1, 4, 9, 300, -1])
def test_truncated_files(path: Path, keep: int) -> None:
    save_weights(path, _state(), _CARD)
    path.write_bytes(path.read_bytes()[:keep])
    # One whose first bytes are gone can be anything.
    expected = "is truncated or damaged: copy" if keep > 8 or keep < 0 else "is"
    with pytest.raises(WeightsError, match=expected) as caught:
        load_weights(path)
    assert "pickle" not in str(caught.value)


def test_a_header_that_begins_like_a_pickle_is_none(path: Path) -> None:
    # 640 bytes: 0x80 0x02, as protocol 2 begins.
    text = safetensors.torch.save({"w": torch.zeros(2)}, {METADATA_KEY: "{}"})
    header = text[8:-8].rstrip().ljust(640)
    data = (640).to_bytes(8, "little") + header + text[-8:]
    path.write_bytes(data)
    with pytest.raises(WeightsError, match="model card: it lacks"):
        load_weights(path)
    path.write_bytes(data[:-1])
    with pytest.raises(WeightsError, match="truncated or damaged"):
        load_weights(path)


def test_other_files(path: Path) -> None:
    with pytest.raises(WeightsError, match=r"no weights at .*check the path"):
        load_weights(path)
    with pytest.raises(WeightsError, match="is a folder"):
        load_weights(path.parent)
    path.write_bytes(b"")
    with pytest.raises(WeightsError, match="is empty: copy or export it again"):
        load_weights(path)
    with pytest.raises(WeightsError, match="no weights at"):
        load_weights(path / "in_a_file")
    path.write_text("<html>404: there is no such page</html>")
    with pytest.raises(WeightsError, match="is not safetensors"):
        load_weights(path)
    for metadata in (None, {"format": "pt"}):
        path.write_bytes(safetensors.torch.save(_state(), metadata))
        with pytest.raises(WeightsError, match="has no model card"):
            load_weights(path)


def test_newer_cards_ask_for_a_newer_package(path: Path) -> None:
    _save(path, format_version=FORMAT_VERSION + 1, novelty=3)
    with pytest.raises(
        WeightsError, match=r"format version 2; .* reads 1: upgrade xray-drake$"
    ):
        load_weights(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no JSON"),
        ('{"architecture": ', "is no JSON"),
        ("[" * 100_000, "is no JSON"),
        ("[1]", "is a list, no mapping"),
        ("{}", "lacks architecture, box_size, data"),
    ],
)
def test_broken_cards(path: Path, text: str, message: str) -> None:
    expected = f"model card: it {message}.*; copy or export it again$"
    with pytest.raises(WeightsError, match=expected):
        load_weights(_save_text(path, text))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("format_version", 0, "format_version is 0, not 1"),
        ("format_version", "2", "format_version is '2', not 1"),
        ("architecture", "", "architecture is empty"),
        ("architecture", None, "architecture is None, no text"),
        ("notes", 3, "notes is 3, no text"),
        ("input", "rgb", "input is 'rgb', not one of geometry, augmented"),
        ("targets", "lid", "targets is 'lid', no list of names"),
        ("targets", [1], r"targets is \[1\], no list of names"),
        ("box_size", [0.03, 0.03], "not three lengths"),
        ("box_size", 0.03, "not three lengths"),
        ("box_size", [0.03, 0.03, 0], "all must be above 0"),
        ("options", [1], r"options is \[1\], no mapping"),
        ("novelty", 3, "unknown fields novelty"),
    ],
)
def test_broken_fields(
    path: Path, field: str, value: object, message: str
) -> None:
    with pytest.raises(WeightsError, match=message) as caught:
        load_weights(_save(path, **{field: value}))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_cards_hold_what_json_holds() -> None:
    card = dataclasses.replace(
        _CARD,
        box_size=(0.03, np.float32(0.03), 0.005),
        training={"mean": np.float32([0.5, 0.25]), "loss": torch.tensor(2.0)},
        figures={1: float("nan"), "count": np.int64(3), "ok": np.bool_(True)},
    )
    assert card.training == {"mean": [0.5, 0.25], "loss": 2.0}
    assert card.figures == {"1": None, "count": 3, "ok": True}
    assert NetworkCard.from_json(card.to_json()) == card
    for value in (float("inf"), Path("x"), {1, 2}):
        with pytest.raises(ValueError, match=r"data\.a\.0 is .* cannot hold"):
            dataclasses.replace(_CARD, data={"a": [value]})


def test_a_person_can_read_the_card() -> None:
    page = dataclasses.replace(
        _CARD, box_size=(0.03, 0.03, 0.005), notes="", data={"of": "a|b\nc"}
    ).to_markdown()
    assert page.startswith("# CompactNet\n\n| | |\n|---|---|\n")
    for line in (
        "| targets | box_1to1, box_2to1 |",
        "| target size | 30 × 30 × 5 mm |",
        "## Options",
        "| widths | 24, 48 |",
        "| of | a\\|b c |",
        "| learning rate | 1e-05 |",
        "| flip | yes |",
        "| test.box_1to1.iou | 0.91 |",
    ):
        assert line in page.splitlines()
    page = _CARD.to_markdown()
    assert "\nA first | try.\n" in page
    assert "| target size | any; it is told the size |" in page
    assert "| datasets.1.seed | 10000 |" in page


_LEAVES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(max_size=8),
)
_TREES = st.dictionaries(
    st.text(max_size=5),
    st.recursive(
        _LEAVES,
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.text(max_size=5), inner, max_size=3)
        ),
        max_leaves=6,
    ),
    max_size=3,
)
_LENGTHS = st.floats(1e-4, 1.0)
_CARDS = st.builds(
    NetworkCard,
    architecture=st.text(min_size=1, max_size=8),
    options=_TREES,
    input=st.sampled_from(INPUTS),
    targets=st.lists(st.text(max_size=5), max_size=3),
    box_size=st.none() | st.tuples(_LENGTHS, _LENGTHS, _LENGTHS),
    data=_TREES,
    training=_TREES,
    figures=_TREES,
    package_version=st.text(max_size=5),
    notes=st.text(max_size=20),
)


@settings(max_examples=60, deadline=None)
@given(card=_CARDS)
def test_every_card_comes_back(card: NetworkCard) -> None:
    assert NetworkCard.from_json(card.to_json()) == card
    stored = safetensors.torch.save({}, {METADATA_KEY: card.to_json()})
    length = int.from_bytes(stored[:8], "little")
    header = json.loads(stored[8 : 8 + length])["__metadata__"]
    assert NetworkCard.from_json(header[METADATA_KEY]) == card
    card.to_markdown()
