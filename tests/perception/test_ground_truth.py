import numpy as np
import pytest

from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.ground_truth import (
    instances_from_labels,
    target_instance,
)

LABELS = np.array([[0, 7, 7, 9], [0, 7, 3, 9], [32767, 3, 3, 9]], np.int16)


def test_instances_are_the_objects_seen_that_are_asked_for() -> None:
    names = {"box": 3, "hidden": 5, "cup": 7}
    instances = instances_from_labels(LABELS, names)
    assert instances.names == ("box", "cup")
    assert instances.labels.tolist() == [
        [-1, 1, 1, -1],
        [-1, 1, 0, -1],
        [-1, 0, 0, -1],
    ]
    assert instances_from_labels(LABELS, {}).names == ()


HALF_COVERED = InstanceMasks([[0, 0, 1, 1], [0, 0, 1, -1]], ("a", "b"))


@pytest.mark.parametrize(
    ("target", "share", "name"),
    [
        ([[1, 1, 0, 0], [1, 1, 0, 0]], 0.5, "a"),
        ([[0, 0, 1, 1], [0, 0, 0, 0]], 0.5, "b"),  # 2 of its 3 pixels
        ([[1, 1, 1, 1], [1, 0, 1, 0]], 0.5, "a"),  # both, more of a
        ([[1, 0, 0, 0], [1, 0, 0, 0]], 0.5, "a"),  # just half
        ([[1, 0, 0, 0], [0, 0, 0, 0]], 0.5, ""),  # too little of a
        ([[1, 0, 0, 0], [0, 0, 0, 0]], 0.25, "a"),
        ([[1, 0, 0, 0], [0, 0, 0, 0]], 0.26, ""),
        ([[0, 0, 0, 0], [0, 0, 0, 1]], 0.5, ""),  # only background
        ([[0, 0, 0, 0], [0, 0, 0, 0]], 0.5, ""),  # not seen
    ],
)
def test_the_instance_that_is_the_target(
    target: list[list[int]], share: float, name: str
) -> None:
    found = target_instance(HALF_COVERED, TargetMask(target), min_overlap=share)
    assert found == name


def test_masks_of_two_images() -> None:
    with pytest.raises(ValueError, match=r"\(2, 4\) .* \(3, 4\): .* one image"):
        target_instance(HALF_COVERED, TargetMask(np.zeros((3, 4))))
