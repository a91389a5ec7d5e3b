import copy
import dataclasses

import numpy as np
import pytest
from pydrake.common.value import Value

from xray_drake.messages import (
    Grasp,
    GraspKind,
    GraspPlan,
    GripperStatus,
    InstanceMasks,
    Message,
    OccupancyDistribution,
    Outcome,
    Rejection,
    SearchAction,
    TargetMask,
)

MESSAGES = [
    TargetMask(np.eye(3)),
    InstanceMasks(np.zeros((2, 2)), ("a",)),
    OccupancyDistribution(np.ones((2, 2))),
    Grasp(GraspKind.JAW, "a"),
    SearchAction(3),
    GripperStatus(),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_a_copy_is_the_message_itself_since_it_cannot_be_changed(
    message: Message,
) -> None:
    assert copy.copy(message) is message
    assert copy.deepcopy({"deep": [message]})["deep"][0] is message
    value = Value(message)
    assert value.get_value() is value.Clone().get_value()
    for field in dataclasses.fields(message):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(message, field.name, None)
        array = getattr(message, field.name)
        if isinstance(array, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                array[0, 0] = 7


@pytest.mark.parametrize(
    ("kind", "field", "dtype"),
    [
        (TargetMask, "data", bool),
        (InstanceMasks, "labels", np.int32),
        (OccupancyDistribution, "data", np.float32),
        (Grasp, "X_WG", np.float64),
        (Grasp, "X_OG", np.float64),
    ],
)
def test_arrays_are_taken_over_as_they_were(
    kind: type[Message], field: str, dtype: type
) -> None:
    source = np.ones((4, 4), dtype)
    message = kind(**{field: source})
    source[0, 0] = 0
    kept = getattr(message, field)
    assert kept[0, 0] == 1
    assert kept.dtype == dtype
    assert source.flags.writeable  # the sender may go on using it


def test_a_plan_says_in_one_line_why_candidates_failed() -> None:
    rejections = [
        Rejection(GraspKind.JAW, "too wide", 40),
        Rejection(GraspKind.JAW, "jaw hits mug", 7),
        Rejection(GraspKind.JAW, "jaw hits floor", 3),
        Rejection(GraspKind.JAW, "failed before", 2),
        Rejection(GraspKind.SUCTION, "cup does not seal", 9),
    ]
    assert GraspPlan(rejections=tuple(rejections)).why_not(2) == (
        "jaw: 40 × too wide, 7 × jaw hits mug, 5 × otherwise; "
        "suction: 9 × cup does not seal"
    )
    assert GraspPlan().why_not() == ""


def test_a_message_without_a_grasp_is_false() -> None:
    for kind in GraspKind:
        there = kind is not GraspKind.NONE
        assert bool(Grasp(kind)) is bool(GraspPlan(Grasp(kind))) is there
    assert not SearchAction().grasp


def test_areas_and_masks_of_instances() -> None:
    labels = np.array([[-1, 0, 2], [2, 2, -1]])
    masks = InstanceMasks(labels, ("a", "hidden", "c", "beyond"))
    assert masks.areas().tolist() == [1, 0, 3, 0]
    assert InstanceMasks(-np.ones((2, 3)), ("a",)).areas().tolist() == [0]
    assert InstanceMasks().areas().tolist() == []
    np.testing.assert_array_equal(masks.mask("c"), labels == 2)
    assert not masks.mask("hidden").any()
    with pytest.raises(ValueError):
        masks.mask("nobody")


def test_support_is_what_exceeds_the_threshold() -> None:
    data = np.array([[0.0, 0.02, 0.05], [0.1, 0.5, 1.0]], np.float32)
    exact = OccupancyDistribution(data)
    learned = OccupancyDistribution(data, support_threshold=0.03)
    assert exact.support_size() == 5
    assert learned.support_size() == 4
    assert exact.support_01_size() == learned.support_01_size() == 2
    np.testing.assert_array_equal(learned.support(), data > 0.03)
    np.testing.assert_array_equal(learned.supported(), data * (data > 0.03))
    assert learned.supported().dtype == np.float32


def test_words_of_the_record() -> None:
    """What records are written and read with."""
    assert {o.value for o in Outcome if o is not Outcome.NONE} == {
        *("lifted", "failed", "slipped", "no_grasp")
    }
    assert [k.value for k in GraspKind if k is not GraspKind.NONE] == [
        *("jaw", "suction")
    ]
