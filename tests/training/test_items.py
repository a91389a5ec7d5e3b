import dataclasses
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    GeometryInput,
)
from xray_drake.training.items import Item, make_item, pack, unpack

_shapes = st.tuples(
    st.integers(1, 5).map(lambda i: 4 * i),
    st.integers(1, 5).map(lambda i: 4 * i),
)
"""The least that is a multiple of 4; a network wants more."""

_unit = st.floats(0, 1, width=32)


@st.composite
def _images(
    draw: st.DrawFn,
) -> tuple[GeometryInput, np.ndarray, np.ndarray]:
    """Any inputs, a label and an amodal mask."""
    height, width = draw(_shapes)
    modal = draw(arrays(bool, (height, width)))
    fine = np.stack(
        [
            draw(arrays(np.float32, (height, width), elements=_unit)),
            modal.astype(np.float32),
        ]
    )
    quarter = (len(COARSE), height // 4, width // 4)
    coarse = draw(arrays(np.float32, quarter, elements=_unit))
    occupancy = draw(
        arrays(
            draw(st.sampled_from([np.float32, np.float64])),
            (height, width),
            elements=_unit,
        )
    )
    amodal = draw(arrays(bool, (height, width)))
    return GeometryInput(fine, coarse), occupancy, amodal


@st.composite
def _items(draw: st.DrawFn) -> Item:
    """Any item: sixteen levels of the cover, masks, bytes."""
    height, width = draw(_shapes)
    size = (height, width)

    def image(*values: int) -> np.ndarray:
        return draw(arrays(np.uint8, size, elements=st.sampled_from(values)))

    levels, masks = range(0, 256, 17), (0, 255)
    quarter = (len(COARSE), height // 4, width // 4)
    return Item(
        fine=np.stack([image(*levels), image(*masks)]),
        coarse=draw(arrays(np.uint8, quarter)),
        labels=np.stack([draw(arrays(np.uint8, size)), image(*masks)]),
    )


def _random(shape: tuple[int, int] = (12, 16), seed: int = 0) -> Item:
    """An item of values that are all as likely."""
    rng = np.random.default_rng(seed)
    height, width = shape

    def mask() -> np.ndarray:
        return 255 * rng.integers(0, 2, shape)

    return Item(
        fine=np.stack([17 * rng.integers(0, 16, shape), mask()]).astype("u1"),
        coarse=rng.integers(0, 256, (3, height // 4, width // 4)).astype("u1"),
        labels=np.stack([rng.integers(0, 256, shape), mask()]).astype("u1"),
    )


def _same(one: Item, other: Item) -> bool:
    pairs = [
        (getattr(one, field.name), getattr(other, field.name))
        for field in dataclasses.fields(Item)
    ]
    assert all(b.dtype == np.uint8 for _, b in pairs)
    return all(np.array_equal(a, b) for a, b in pairs)


@given(item=_items())
@settings(deadline=None, max_examples=100)
def test_what_is_packed_is_unpacked_bit_for_bit(item: Item) -> None:
    shape = item.fine.shape[1:]
    data = pack(item)
    assert isinstance(data, bytes)
    assert _same(item, unpack(data, shape))
    # The same item has the same bytes.
    assert pack(unpack(data, shape)) == data


@given(images=_images())
@settings(deadline=None, max_examples=100)
def test_rounding_is_to_the_nearest_level(
    images: tuple[GeometryInput, np.ndarray, np.ndarray],
) -> None:
    (fine, coarse), occupancy, amodal = images
    before = [image.copy() for image in (fine, coarse, occupancy, amodal)]
    item = make_item(GeometryInput(fine, coarse), occupancy, amodal)
    for image, other in zip(
        (fine, coarse, occupancy, amodal), before, strict=True
    ):
        np.testing.assert_array_equal(image, other)
    assert _same(item, unpack(pack(item), item.fine.shape[1:]))
    assert item.fine.shape == fine.shape
    assert item.coarse.shape == coarse.shape
    assert item.labels.shape == (2, *occupancy.shape)
    rounding = 1e-6
    # The cover has sixteen levels, of which 0 and 1 are the outermost ...
    cover = np.abs(item.fine[0] / 255 - fine[0])
    assert cover.max() <= 0.5 / 15 + rounding
    # ... the rest has 256; masks are exact.
    assert np.abs(item.coarse / 255 - coarse).max() <= 0.5 / 255 + rounding
    error = np.abs(item.labels[0] / 255 - occupancy)
    assert error.max() <= 0.5 / 255 + rounding
    np.testing.assert_array_equal(item.fine[1], 255 * fine[1])
    np.testing.assert_array_equal(item.labels[1], 255 * amodal)


@pytest.mark.parametrize("value", [0, 1])
def test_nothing_and_all_are_exact(value: int) -> None:
    inputs = GeometryInput(
        np.full((len(FINE), 8, 12), value, np.float32),
        np.full((len(COARSE), 2, 3), value, np.float32),
    )
    label = np.full((8, 12), value, np.float32)
    item = make_item(inputs, label, label > 0)
    for images in (item.fine, item.coarse, item.labels):
        assert (images == 255 * value).all()


def test_pixels_keep_their_places() -> None:
    inputs = GeometryInput(
        np.zeros((2, 8, 12), np.float32), np.zeros((3, 2, 3), np.float32)
    )
    labels = np.zeros((2, 8, 12))
    for number, images in enumerate((*inputs, labels)):
        for place in np.ndindex(images.shape):
            images[place] = 1
            item = make_item(inputs, labels[0], labels[1] > 0)
            found = unpack(pack(item), (8, 12))
            for other, image in enumerate(
                (found.fine, found.coarse, found.labels)
            ):
                assert np.count_nonzero(image) == (number == other)
                assert other != number or image[place] == 255
            images[place] = 0


@given(
    shape=_shapes,
    other=st.tuples(*[st.integers(1, 6).map(lambda i: 4 * i)] * 2),
)
@settings(deadline=None, max_examples=100)
def test_bytes_of_another_number_of_pixels_are_refused(
    shape: tuple[int, int], other: tuple[int, int]
) -> None:
    data = pack(_random(shape))
    if np.prod(shape) == np.prod(other):
        unpack(data, other)
        return
    with pytest.raises(ValueError, match=f"than {other[0]}×{other[1]}"):
        unpack(data, other)


def test_bytes_of_something_else_are_refused() -> None:
    raw = zlib.decompress(pack(_random()))
    for wrong in (raw[:-1], raw + b"\0", b""):
        with pytest.raises(ValueError, match="an item of another shape"):
            unpack(zlib.compress(wrong), (12, 16))


@given(end=st.integers(0, 10_000))
@settings(deadline=None, max_examples=50)
def test_bytes_that_are_cut_off_are_damaged(end: int) -> None:
    data = pack(_random())
    with pytest.raises(zlib.error):
        unpack(data[: end % len(data)], (12, 16))


@given(place=st.integers(0, 10_000), bit=st.integers(0, 7))
@settings(deadline=None, max_examples=200)
def test_no_damage_makes_another_item(place: int, bit: int) -> None:
    item = _random()
    data = bytearray(pack(item))
    data[place % len(data)] ^= 1 << bit
    try:
        found = unpack(bytes(data), (12, 16))
    except zlib.error:
        return
    # A bit that stands for nothing.
    assert _same(item, found)


def test_what_is_mostly_empty_is_small() -> None:
    fine = np.zeros((2, 384, 512), np.float32)
    fine[:, 100:180, 200:280] = 1
    inputs = GeometryInput(fine, np.zeros((3, 96, 128), np.float32))
    item = make_item(inputs, fine[0], fine[1] > 0)
    assert len(pack(item)) < 10_000
    # Noise cannot be made small, but masks have a bit of each pixel, and the
    # cover has four.
    pixels = 384 * 512
    packed = len(pack(_random((384, 512))))
    assert packed < 1.01 * pixels * (4 + 1 + 8 * 3 / 16 + 8 + 1) / 8
