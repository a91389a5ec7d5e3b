"""Masks from the label image: the paper's perception in simulation."""

from collections.abc import Mapping

import numpy as np

from xray_drake.messages import InstanceMasks, TargetMask


def instances_from_labels(
    labels: np.ndarray, names: Mapping[str, int]
) -> InstanceMasks:
    """Returns the modal masks of the objects that are seen.

    Args:
        labels: (H, W) integer label image.
        names: object name to its value in the label image.
    """
    seen = set(np.unique(labels).tolist())
    visible = [name for name, label in names.items() if label in seen]
    masks = np.full(labels.shape, -1, np.int32)
    for index, name in enumerate(visible):
        masks[labels == names[name]] = index
    return InstanceMasks(masks, tuple(visible))


def target_instance(
    instances: InstanceMasks, target: TargetMask, *, min_overlap: float = 0.5
) -> str:
    """Returns the name of the instance that is the target, or ``""``.

    Args:
        instances: masks of all objects.
        target: the target's modal mask.
        min_overlap: share of the instance's pixels that must be the target's.

    Raises:
        ValueError: the two images differ in shape.
    """
    if instances.labels.shape != target.data.shape:
        raise ValueError(
            f"the instance image is {instances.labels.shape} but the target "
            f"mask {target.data.shape}: both must come from one image"
        )
    inside = instances.labels[target.data]
    inside = inside[inside >= 0]
    if inside.size == 0:
        return ""
    overlap = np.bincount(inside, minlength=len(instances.names))
    best = int(np.argmax(overlap))
    if overlap[best] < min_overlap * instances.areas()[best]:
        return ""
    return instances.names[best]
