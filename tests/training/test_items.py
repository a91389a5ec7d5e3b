import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from xray_drake.occupancy.learned.inputs import (
    COARSE,
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
    height, width = size = draw(_shapes)

    def image(*shape: int) -> np.ndarray:
        return draw(arrays(np.float32, shape, elements=_unit))

    modal = draw(arrays(bool, size)).astype(np.float32)
    fine = np.stack([image(*size), modal])
    coarse = image(len(COARSE), height // 4, width // 4)
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    occupancy = image(*size).astype(dtype)
    return GeometryInput(fine, coarse), occupancy, draw(arrays(bool, size))


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
        (getattr(one, name), getattr(other, name))
        for name in ("fine", "coarse", "labels")
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
    """Sixteen of the cover, 256 of the rest, from 0 to 1; masks are exact."""
    (fine, coarse), occupancy, amodal = images
    before = [image.copy() for image in (fine, coarse, occupancy, amodal)]
    item = make_item(GeometryInput(fine, coarse), occupancy, amodal)
    for image, other in zip(
        (fine, coarse, occupancy, amodal), before, strict=True
    ):
        np.testing.assert_array_equal(image, other)
    for found, expected, levels in (
        (item.fine, fine, [[[15]], [[np.inf]]]),
        (item.coarse, coarse, 255),
        (item.labels, [occupancy, amodal], [[[255]], [[np.inf]]]),
    ):
        error = np.abs(found / 255 - expected)
        assert (error <= 0.5 / np.array(levels) + 1e-6).all()


@pytest.mark.parametrize("shape", [(12, 12), (12, 20), (20, 16)])
def test_bytes_of_another_number_of_pixels_are_refused(
    shape: tuple[int, int],
) -> None:
    data = pack(_random((12, 16)))
    unpack(data, (16, 12))
    with pytest.raises(ValueError, match=f"than {shape[0]}×{shape[1]}"):
        unpack(data, shape)


@given(place=st.integers(0, 10_000), bit=st.integers(0, 8))
@settings(deadline=None, max_examples=200)
def test_no_damage_makes_another_item(place: int, bit: int) -> None:
    """A bit is flipped, or the bytes are cut off."""
    item = _random()
    data = bytearray(pack(item))
    place %= len(data)
    if bit == 8:
        data = data[:place]
    else:
        data[place] ^= 1 << bit
    try:
        found = unpack(bytes(data), (12, 16))
    except zlib.error:
        return
    # A bit that stands for nothing.
    assert bit < 8
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
