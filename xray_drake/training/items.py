"""What a network is trained on, packed: an image's inputs and labels.

At the camera's resolution they are a megabyte of bytes; masks need a bit of
each, the cover's slope four, and most of a label is empty. Packed and
compressed an item has some tens of kilobytes, so that a dataset of tens of
thousands stays in memory.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from xray_drake.occupancy.learned.inputs import (
    COARSE,
    QUARTER,
    GeometryInput,
)

_LEVELS = 15
"""Of the cover, which goes from 0 to 1 over 4 mm."""


@dataclass(frozen=True, eq=False)
class Item:
    """An image's inputs and labels, in [0, 255].

    Attributes:
        fine: (2, H, W) uint8, see ``GeometryInput``.
        coarse: (3, H/4, W/4) uint8, the same.
        labels: (2, H, W) uint8, the occupancy distribution and the amodal
            mask.
    """

    fine: np.ndarray
    coarse: np.ndarray
    labels: np.ndarray


def make_item(
    inputs: GeometryInput, occupancy: np.ndarray, amodal: np.ndarray
) -> Item:
    """Rounds inputs and labels to what an item keeps of them.

    Args:
        inputs: of the network.
        occupancy: (H, W) in [0, 1].
        amodal: (H, W) bool.
    """
    cover, modal = inputs.fine
    levels = np.rint(cover * _LEVELS).astype(np.uint8) * (255 // _LEVELS)
    return Item(
        fine=np.stack([levels, (modal > 0) * np.uint8(255)]),
        coarse=np.rint(inputs.coarse * 255).astype(np.uint8),
        labels=np.stack(
            [
                np.rint(occupancy * 255).astype(np.uint8),
                (amodal > 0) * np.uint8(255),
            ]
        ),
    )


def pack(item: Item) -> bytes:
    """Returns an item's bytes; :func:`unpack` gives it back, bit for bit."""
    levels = item.fine[0].ravel() // (255 // _LEVELS)
    parts = (
        levels[0::2] << 4 | levels[1::2],
        np.packbits(item.fine[1]),
        item.coarse,
        item.labels[0],
        np.packbits(item.labels[1]),
    )
    return zlib.compress(b"".join(part.tobytes() for part in parts), level=1)


def unpack(data: bytes, shape: tuple[int, int]) -> Item:
    """Returns the item of :func:`pack`.

    Args:
        data: its bytes.
        shape: H and W; their product is a multiple of 8.

    Raises:
        ValueError: the bytes are of an image with another number of pixels.
        zlib.error: they are damaged.
    """
    height, width = shape
    pixels = height * width
    coarse_shape = (len(COARSE), height // QUARTER, width // QUARTER)
    lengths = (
        pixels // 2,
        pixels // 8,
        int(np.prod(coarse_shape)),
        pixels,
        pixels // 8,
    )
    raw = np.frombuffer(zlib.decompress(data), np.uint8)
    if len(raw) != sum(lengths):
        raise ValueError(f"an item of another shape than {height}×{width}")
    cover, modal, coarse, occupancy, amodal = np.split(
        raw, np.cumsum(lengths)[:-1]
    )
    fine = np.empty((2, pixels), np.uint8)
    fine[0, 0::2] = (cover >> 4) * (255 // _LEVELS)
    fine[0, 1::2] = (cover & 15) * (255 // _LEVELS)
    fine[1] = np.unpackbits(modal) * 255
    labels = np.stack([occupancy, np.unpackbits(amodal) * 255])
    return Item(
        fine=fine.reshape(2, height, width),
        coarse=coarse.reshape(coarse_shape),
        labels=labels.reshape(2, height, width),
    )
