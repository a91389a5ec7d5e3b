"""Grasp-aware: what stands in the gripper's way goes first."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.policy.blocks import (
    SCALE,
    TARGET,
    Block,
    planning,
    target_block,
)
from tests.policy.blocks import view as blocks_view
from xray_drake.messages import Grasp, GraspKind, RankedCandidate
from xray_drake.policy.beyond.chance import chance
from xray_drake.policy.beyond.grasp_aware import GraspAware
from xray_drake.policy.beyond.lookahead import Lookahead
from xray_drake.policy.ranking import (
    Planning,
    Ranking,
    SearchView,
    largest,
    order,
    xray,
)

SEEN = target_block(45, 55)
LEFT = Block("left", 40, 45, 15, 9, 0.08)
RIGHT = Block("right", 43, 66, 8, 9, 0.04)
FAR = Block("far", 20, 100, 20, 20, 0.04)
ALL = [SEEN, LEFT, RIGHT, FAR]
GOOD = {"left": 0.9, "right": 0.9, "far": 0.9}


def view(blocks: Sequence[Block], plan: Planning) -> SearchView:
    """The target is known to be where it is."""
    return blocks_view(blocks, plan, SEEN.mask * (SEEN in blocks))


def ranked(seen: SearchView, ranking: GraspAware) -> list[RankedCandidate]:
    return order(seen, ranking, np.random.default_rng(0))


class Noting:
    """A planner that notes what is asked."""

    def __init__(self, plan: Planning) -> None:
        self._plan = plan
        self.asked: list[tuple[str, tuple[str, ...]]] = []

    def __call__(self, name: str, *, without: Collection[str] = ()) -> Grasp:
        self.asked.append((name, tuple(without)))
        return self._plan(name, without=without)


def test_a_target_that_can_be_grasped_is_next() -> None:
    plan = Noting(planning({**GOOD, TARGET: 0.5}))
    (name, score, *_), *_ = ranked(view(ALL, plan), GraspAware())
    assert name == TARGET
    assert score == chance(planning({TARGET: 0.5})(TARGET).grasp)
    assert plan.asked == [(TARGET, ())]


@pytest.mark.parametrize("blocker", ["left", "right"])
def test_what_blocks_the_grasp_goes_first(blocker: str) -> None:
    freed = {(TARGET, blocker): 0.6}
    (name, score, *_), *_ = ranked(
        view(ALL, planning(GOOD, freed)), GraspAware()
    )
    assert name == blocker
    first, then = (
        chance(planning({"it": quality})("it").grasp) for quality in (0.9, 0.6)
    )
    assert score == pytest.approx(first * then / (first + then))


def test_of_two_ways_the_one_with_fewer_actions() -> None:
    freed = {(TARGET, "left"): 0.9, (TARGET, "right"): 0.5}
    for qualities, name in (
        (GOOD, "left"),
        ({**GOOD, "left": 0.25}, "right"),
        ({"right": 0.9, "far": 0.9}, "right"),
    ):
        seen = view(ALL, planning(qualities, freed))
        assert ranked(seen, GraspAware())[0][0] == name


def test_one_action_is_worth_more_than_two() -> None:
    """However weak the one and however good the two."""
    freed = {(TARGET, "left"): 1.0}
    weak = view(ALL, planning({**GOOD, TARGET: 0.01}, freed))
    strong = view(ALL, planning({**GOOD, "left": 1.0}, freed))
    one = ranked(weak, GraspAware())[0]
    two = ranked(strong, GraspAware())[0]
    assert (one[0], two[0]) == (TARGET, "left")
    assert one[1] > two[1]


def test_only_what_is_near_is_thought_away() -> None:
    plan = Noting(planning(GOOD))
    ranked(view(ALL, plan), GraspAware())
    thought_away = {gone for _, without in plan.asked for gone in without}
    assert thought_away == {"left", "right"}
    plan.asked.clear()
    ranked(view(ALL, plan), GraspAware(candidates=1))
    assert (TARGET, ("left",)) in plan.asked
    assert (TARGET, ("right",)) not in plan.asked


def test_where_none_helps_what_takes_the_place_goes_first() -> None:
    """Over the target, or where the fingers go; not what is merely large."""
    lid = Block("lid", 44, 60, 7, 6, 0.05)
    seen = view([*ALL, lid], planning({**GOOD, "lid": 0.9}))
    room = GraspAware().finger * SCALE
    rows, columns = np.nonzero(SEEN.mask)
    places = dict.fromkeys(seen.candidates, 0.0)
    for name in ("left", "right", "far", "lid"):
        for row, column in np.argwhere(seen.instances.mask(name)).tolist():
            away = np.hypot(rows - row, columns - column).min()
            places[name] += 1.0 if away == 0 else 0.5 * (away <= room)
    names = [c.name for c in ranked(seen, GraspAware())]
    assert names == sorted(seen.candidates, key=lambda n: -places[n])
    assert names[0] == "lid"


def test_what_is_in_the_way_is_worth_a_weak_grasp() -> None:
    freed = {(TARGET, "left"): 0.6}
    for plan in (planning(GOOD), planning(GOOD, freed)):
        hides = {c.name: c.hides for c in ranked(view(ALL, plan), GraspAware())}
        assert hides == {
            TARGET: True,
            "left": True,
            "right": True,
            "far": False,
        }


def test_while_the_target_is_not_seen_another_ranking_decides() -> None:
    seen = view([LEFT, RIGHT, FAR], planning(GOOD))
    rng = np.random.default_rng(0)
    for search in (xray, largest):
        np.testing.assert_array_equal(
            GraspAware(search)(seen, rng).values, search(seen, rng).values
        )
    peeping = replace(view(ALL, planning(GOOD)), candidates=("left", "far"))
    np.testing.assert_array_equal(
        GraspAware(largest)(peeping, rng).values,
        largest(peeping, rng).values,
    )


@pytest.mark.parametrize("ranking", [GraspAware(), Lookahead()])
def test_what_imagining_needs_is_named(ranking: Ranking) -> None:
    seen = view(ALL, planning(GOOD))
    for lacking in (replace(seen, outlook=None), replace(seen, plan=None)):
        with pytest.raises(ValueError, match="an outlook and a planner"):
            ranking(lacking, np.random.default_rng(0))


def test_better_grasps_have_better_chances_between_what_was_counted() -> None:
    grasps = [
        Grasp(GraspKind.SUCTION, "cup", quality=quality)
        for quality in np.linspace(0.01, 1.0, 100)
    ]
    chances = [chance(grasp) for grasp in grasps]
    assert chances == sorted(chances)
    assert chances[:20] == [0.5] * 20
    assert chances[-30:] == pytest.approx([0.94] * 30)
    assert len(set(chances)) > 40
    assert chance(Grasp()) == 0.0
