"""The instance masks of a labelled image."""

from collections.abc import Sequence

import numpy as np


def instance_image(
    labels: np.ndarray, target: int, objects: Sequence[int]
) -> np.ndarray:
    """Numbers the objects that are seen (DESIGN.md, "Dataset on disk").

    Args:
        labels: (H, W) integer label image, one value per body.
        target: the target's value in it.
        objects: the others' values, in the order in which they are numbered.

    Returns:
        (H, W) uint8: 0 background, 1 target, 2… the objects.

    Raises:
        ValueError: more than 254 objects, or a value given twice.
    """
    values = [target, *objects]
    if len(values) > 255:
        raise ValueError(
            f"an instance image holds 254 objects, not {len(values) - 1}"
        )
    if len(set(values)) < len(values):
        raise ValueError(f"a label is given twice: {values}")
    image = np.zeros(labels.shape, dtype=np.uint8)
    for number, value in enumerate(values, start=1):
        image[labels == value] = number
    return image
