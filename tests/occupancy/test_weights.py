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

from xray_drake.occupancy.learned.weights import (
    FORMAT_VERSION,
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


def _file(metadata: dict[str, str] | None) -> bytes:
    return safetensors.torch.save(_state(), metadata)


def _of_card(text: str) -> bytes:
    """Weights of ours with a card of any text."""
    return _file({METADATA_KEY: text})


def _changed(**change: Any) -> bytes:
    """Weights of ours, with some fields of the card's JSON changed."""
    return _of_card(json.dumps({**json.loads(_CARD.to_json()), **change}))


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
    weights = torch.randn(100, 100, dtype=torch.float64)
    sizes = []
    for half in (False, True):
        save_weights(path, {"w": weights, "n": torch.ones(3)}, _CARD, half=half)
        sizes.append(path.stat().st_size)
        loaded = load_weights(path)[0]["w"]
        assert loaded.dtype == torch.float32
        torch.testing.assert_close(
            loaded, weights.float(), rtol=1e-3 * half, atol=1e-6 * half
        )
    assert sizes[1] < 0.6 * sizes[0]


def test_tied_and_transposed_weights_are_saved(path: Path) -> None:
    tensor = torch.randn(3, 5)
    state = {"a": tensor, "b": tensor, "c": tensor.T}
    save_weights(path, state, _CARD)
    for name, loaded in load_weights(path)[0].items():
        assert torch.equal(loaded, state[name])


def test_loaded_weights_outlive_their_file(path: Path) -> None:
    save_weights(path, {"w": torch.zeros(1000)}, _CARD)
    loaded, _ = load_weights(path)
    with path.open("r+b") as file:
        file.seek(-400, 2)
        file.write(b"\x3f" * 400)
    assert not loaded["w"].any()
    assert load_weights(path)[0]["w"].any()


def test_the_card_is_read_alone(path: Path) -> None:
    weights = {"w": torch.tensor([1.0, torch.nan, torch.inf])}
    metadata = {METADATA_KEY: _CARD.to_json()}
    path.write_bytes(safetensors.torch.save(weights, metadata))
    assert read_card(path) == _CARD
    with pytest.raises(WeightsError, match="damaged: 2 of 3 weights 'w' are"):
        load_weights(path)


def test_only_numbers_are_saved(path: Path) -> None:
    with pytest.raises(WeightsError, match="not written: 1 of 2 weights 'w'"):
        save_weights(path, {"w": torch.tensor([1.0, torch.nan])}, _CARD)
    large = {"w": torch.tensor([1.0, -1e5])}
    with pytest.raises(WeightsError, match=r"reach 1e\+05.*half=False"):
        save_weights(path, large, _CARD, half=True)
    assert not path.exists()
    save_weights(path, large, _CARD)


def _pickled(**options: bool) -> bytes:
    file = io.BytesIO()
    torch.save(_state(), file, **options)
    return file.getvalue()


def _like_a_pickle() -> bytes:
    """A header of 640 bytes: 0x80 0x02, as pickles of protocol 2 begin."""
    text = safetensors.torch.save({"w": torch.zeros(2)}, {METADATA_KEY: "{}"})
    header = text[8:-8].rstrip().ljust(640)
    return (640).to_bytes(8, "little") + header + text[-8:]


_WHOLE = _of_card(_CARD.to_json())
_PICKLE = "is a pickle .*never unpickles: .*xray-drake train"
_CUT = "is truncated or damaged: copy or export it again"
_NO_JSON = "model card: it is no JSON.*; copy or export it again$"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (_pickled(), _PICKLE),
        (_pickled(_use_new_zipfile_serialization=False), _PICKLE),
        (pickle.dumps({"w": [1.0, 2.0]}), _PICKLE),
        (b"", "is empty: copy or export it again"),
        (b"<html>404: there is no such page</html>", "is not safetensors"),
        # One whose first bytes are gone can be anything.
        (_WHOLE[:1], "is not safetensors"),
        (_WHOLE[:4], "is not safetensors"),
        (_WHOLE[:9], _CUT),
        (_WHOLE[:300], _CUT),
        (_WHOLE[:-1], _CUT),
        (_like_a_pickle()[:-1], _CUT),
        (_like_a_pickle(), "model card: it lacks architecture, box_size, data"),
        (_file(None), "has no model card"),
        (_file({"format": "pt"}), "has no model card"),
        (_of_card(""), _NO_JSON),
        (_of_card('{"architecture": '), _NO_JSON),
        (_of_card("[" * 100_000), _NO_JSON),
        (_of_card("[1]"), "model card: it is a list, no mapping"),
        (
            _changed(format_version=FORMAT_VERSION + 1, novelty=3),
            r"format version 2; .* reads 1: upgrade xray-drake$",
        ),
        (_changed(format_version=0), "format_version is 0, not 1"),
        (_changed(format_version="2"), "format_version is '2', not 1"),
        (_changed(architecture=""), "architecture is empty"),
        (_changed(architecture=None), "architecture is None, no text"),
        (_changed(notes=3), "notes is 3, no text"),
        (_changed(input="rgb"), "is 'rgb', not one of geometry, augmented"),
        (_changed(targets="lid"), "targets is 'lid', no list of names"),
        (_changed(targets=[1]), r"targets is \[1\], no list of names"),
        (_changed(box_size=[0.03, 0.03]), "not three lengths"),
        (_changed(box_size=0.03), "not three lengths"),
        (_changed(box_size=[0.03, 0.03, 0]), "all must be above 0"),
        (_changed(options=[1]), r"options is \[1\], no mapping"),
        (_changed(novelty=3), "unknown fields novelty"),
    ],
    ids=lambda value: value if isinstance(value, str) else "file",
)
def test_what_are_no_weights_of_ours_is_one_line(
    path: Path, data: bytes, message: str
) -> None:
    path.write_bytes(data)
    with pytest.raises(WeightsError, match=message) as caught:
        load_weights(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert ("pickle" in str(caught.value)) == (message == _PICKLE)


def test_no_file(path: Path) -> None:
    with pytest.raises(WeightsError, match=r"no weights at .*check the path"):
        load_weights(path)
    with pytest.raises(WeightsError, match="is a folder"):
        load_weights(path.parent)
    path.touch()
    with pytest.raises(WeightsError, match="no weights at"):
        load_weights(path / "in_a_file")


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
    page = _CARD.to_markdown()
    assert page.startswith("# CompactNet\n\nA first | try.\n\n```yaml\n")
    for line in (
        "targets: [box_1to1, box_2to1]",
        "box_size: any; it is told the size",
        "training: {epochs: 40, learning rate: 1.0e-05, flip: true}",
        "    box_1to1: {balanced_accuracy: 0.98, iou: 0.91}",
    ):
        assert line in page.splitlines()
    one_box = dataclasses.replace(_CARD, box_size=(0.03, 0.03, 0.005), notes="")
    page = one_box.to_markdown()
    assert page.startswith("# CompactNet\n\n```yaml\noptions:")
    assert "box_size: [0.03, 0.03, 0.005]\n" in page


_TREES = st.dictionaries(
    st.text(max_size=5),
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.text(max_size=5), inner, max_size=3)
        ),
        max_leaves=6,
    ),
    max_size=3,
)
_LENGTHS = st.floats(1e-4, 1.0)


@settings(max_examples=60)
@given(
    text=st.text(min_size=1, max_size=8),
    tree=_TREES,
    box_size=st.none() | st.tuples(_LENGTHS, _LENGTHS, _LENGTHS),
)
def test_every_card_comes_back(
    text: str, tree: dict[str, Any], box_size: Any
) -> None:
    card = NetworkCard(
        architecture=text,
        options=tree,
        input="geometry",
        targets=(text, ""),
        box_size=box_size,
        training=tree,
        notes=text,
    )
    assert NetworkCard.from_json(card.to_json()) == card
    stored = safetensors.torch.save({}, {METADATA_KEY: card.to_json()})
    length = int.from_bytes(stored[:8], "little")
    header = json.loads(stored[8 : 8 + length])["__metadata__"]
    assert NetworkCard.from_json(header[METADATA_KEY]) == card
    card.to_markdown()
