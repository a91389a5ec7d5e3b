import numpy as np
import pytest

from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.ground_truth import (
    instances_from_labels,
    target_instance,
)

LABELS = np.array([[0, 7, 7, 9], [0, 7, 3, 9], [32767, 3, 3, 9]], np.int16)


def test_instances_are_the_objects_seen() -> None:
    names = {"box": 3, "hidden": 5, "cup": 7, "bowl": 9}
    instances = instances_from_labels(LABELS, names)
    assert instances.names == ("box", "cup", "bowl")
    assert instances.labels.tolist() == [
        [-1, 1, 1, 2],
        [-1, 1, 0, 2],
        [-1, 0, 0, 2],
    ]


def test_what_is_not_asked_for_is_background() -> None:
    instances = instances_from_labels(LABELS, {"cup": 7})
    np.testing.assert_array_equal(instances.labels == 0, LABELS == 7)
    assert instances.labels.min() == -1
    assert instances_from_labels(LABELS, {}).names == ()


def half_covered() -> InstanceMasks:
    return InstanceMasks([[0, 0, 1, 1], [0, 0, 1, -1]], ("a", "b"))


@pytest.mark.parametrize(
    ("target", "name"),
    [
        ([[1, 1, 0, 0], [1, 1, 0, 0]], "a"),
        ([[0, 0, 1, 1], [0, 0, 0, 0]], "b"),  # 2 of its 3 pixels
        ([[1, 1, 1, 1], [1, 0, 1, 0]], "a"),  # both, more of a
        ([[1, 0, 0, 0], [1, 0, 0, 0]], "a"),  # just half
        ([[1, 0, 0, 0], [0, 0, 0, 0]], ""),  # too little of a
        ([[0, 0, 0, 0], [0, 0, 0, 1]], ""),  # only background
        ([[0, 0, 0, 0], [0, 0, 0, 0]], ""),  # not seen
    ],
)
def test_the_instance_that_is_the_target(
    target: list[list[int]], name: str
) -> None:
    assert target_instance(half_covered(), TargetMask(target)) == name


def test_how_much_of_the_instance_must_be_the_targets() -> None:
    corner = TargetMask([[1, 0, 0, 0], [0, 0, 0, 0]])
    assert target_instance(half_covered(), corner, min_overlap=0.25) == "a"
    assert target_instance(half_covered(), corner, min_overlap=0.26) == ""


def test_masks_of_two_images() -> None:
    with pytest.raises(ValueError, match="from one image") as caught:
        target_instance(half_covered(), TargetMask(np.zeros((3, 4))))
    assert "(2, 4)" in str(caught.value)
    assert "(3, 4)" in str(caught.value)
