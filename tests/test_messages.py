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


def arrays(message: Message) -> list[tuple[str, np.ndarray]]:
    values = [
        (field.name, getattr(message, field.name))
        for field in dataclasses.fields(message)
    ]
    return [(name, v) for name, v in values if isinstance(v, np.ndarray)]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_a_copy_is_the_message_itself(message: Message) -> None:
    assert copy.copy(message) is message
    assert copy.deepcopy(message) is message
    assert copy.deepcopy({"deep": [message]})["deep"][0] is message
    value = Value(message)
    assert value.get_value() is value.Clone().get_value()


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_nothing_in_a_message_can_be_changed(message: Message) -> None:
    for field in dataclasses.fields(message):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(message, field.name, None)
    for _, array in arrays(message):
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


def test_defaults_mean_nothing() -> None:
    assert TargetMask().data.size == 0
    assert InstanceMasks().names == ()
    assert OccupancyDistribution().support_size() == 0
    assert not Grasp()
    assert SearchAction().number == 0
    assert not SearchAction().grasp
    status = GripperStatus()
    assert (status.held, status.outcome) == ("", Outcome.NONE)


def test_a_plan_says_in_one_line_why_candidates_failed() -> None:
    jaw, suction = GraspKind.JAW, GraspKind.SUCTION
    plan = GraspPlan(
        rejections=(
            Rejection(jaw, "too wide", 40),
            Rejection(jaw, "jaw hits mug", 7),
            Rejection(jaw, "jaw hits floor", 3),
            Rejection(jaw, "failed before", 2),
            Rejection(suction, "cup does not seal", 9),
        )
    )
    assert not plan
    assert plan.why_not(2) == (
        "jaw: 40 × too wide, 7 × jaw hits mug, 5 × otherwise; "
        "suction: 9 × cup does not seal"
    )
    assert GraspPlan(Grasp(jaw))
    assert GraspPlan().why_not() == ""


@pytest.mark.parametrize("kind", list(GraspKind))
def test_a_grasp_is_true_unless_there_is_none(kind: GraspKind) -> None:
    assert bool(Grasp(kind)) == (kind is not GraspKind.NONE)


def test_areas_and_masks_of_instances() -> None:
    labels = np.array([[-1, 0, 2], [2, 2, -1]])
    masks = InstanceMasks(labels, ("a", "hidden", "c", "beyond"))
    assert masks.areas().tolist() == [1, 0, 3, 0]
    np.testing.assert_array_equal(masks.mask("c"), labels == 2)
    assert not masks.mask("hidden").any()
    with pytest.raises(ValueError):
        masks.mask("nobody")


def test_areas_where_nothing_is_seen() -> None:
    assert InstanceMasks(np.full((2, 3), -1), ("a", "b")).areas().tolist() == [
        0,
        0,
    ]
    assert InstanceMasks().areas().tolist() == []


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
    assert {o.value for o in Outcome if o is not Outcome.NONE} == {
        "lifted",
        "failed",
        "slipped",
        "no_grasp",
    }
    assert GraspKind.JAW.value == "jaw"
    assert GraspKind.SUCTION.value == "suction"
