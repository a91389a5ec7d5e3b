"""Lookahead against removals that really happen, and what it prefers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.policy.blocks import (
    SCALE,
    TARGET,
    TARGET_SIZE,
    Block,
    heights_of,
    hidden_places,
    look,
    planning,
    target_block,
    view,
)
from xray_drake.messages import OccupancyDistribution
from xray_drake.policy.beyond.chance import USUAL, chance
from xray_drake.policy.beyond.lookahead import Lookahead
from xray_drake.policy.ranking import SearchView, order, xray

GREEDY = Lookahead(beam=0)
SILHOUETTE = SCALE**2 * TARGET_SIZE[0] * TARGET_SIZE[1]

SLAB = Block("slab", 20, 30, 30, 40, 0.01)
CUP = Block("cup", 25, 40, 12, 12, 0.06)  # stands on the slab
BOX = Block("box", 70, 20, 10, 10, 0.03)


def names(seen: SearchView, lookahead: Lookahead) -> list[str]:
    rng = np.random.default_rng(0)
    return [c.name for c in order(seen, lookahead, rng)]


def values(seen: SearchView, config: Lookahead) -> dict[str, float]:
    scores = config(seen, np.random.default_rng(0))
    return dict(zip(seen.candidates, scores.values[:, 0].tolist(), strict=True))


def expected(
    blocks: Sequence[Block], gone: Block
) -> tuple[float, float, float]:
    """Returns decrease, chance to see the target, and what is left then."""
    before, after = (
        heights_of(look(some).depth) > TARGET_SIZE[2] - 1e-4
        for some in (blocks, [b for b in blocks if b is not gone])
    )
    size = before.sum()
    revealed = (before & ~after).sum() / size
    least = min(SILHOUETTE, size)
    left = revealed * least + (1 - revealed) * after.sum()
    return size - left, revealed, min(SILHOUETTE, after.sum())


@st.composite
def apart(draw: st.DrawFn) -> list[Block]:
    """Blocks on the floor that do not touch: behind each is the floor."""
    return [
        Block(
            f"{row}{column}",
            4 + 30 * row,
            4 + 42 * column,
            draw(st.integers(3, 24)),
            draw(st.integers(3, 36)),
            draw(st.sampled_from([0.01, 0.03, 0.08])),
        )
        for row in range(2)
        for column in range(3)
        if draw(st.booleans())
    ]


@settings(deadline=None, max_examples=15)
@given(apart(), st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6))
def test_it_expects_what_would_happen(
    blocks: list[Block], qualities: list[float]
) -> None:
    plan = planning(
        {b.name: q for b, q in zip(blocks, qualities, strict=False)}
    )
    seen = view(blocks, plan)
    config = Lookahead(candidates=6, beam=6, second=6)
    chances = {block.name: chance(plan(block.name).grasp) for block in blocks}
    gains = {b.name: chances[b.name] * expected(blocks, b)[0] for b in blocks}
    slow = {}
    for block in blocks:
        _, revealed, least = expected(blocks, block)
        left = [other for other in blocks if other is not block]
        following = max(
            (chances[b.name] * expected(left, b)[0] for b in left), default=0.0
        )
        then = (1 - revealed) * following + revealed * USUAL * least
        others = max((gains[other.name] for other in left), default=0.0)
        p = chances[block.name]
        slow[block.name] = gains[block.name] + config.later * (
            p * then + (1 - p) * others
        )
        if p == 0:
            slow[block.name] = 0.0
    assert values(seen, config) == pytest.approx(slow, rel=1e-5, abs=1e-3)
    greedy = Lookahead(candidates=6, beam=0)
    assert values(seen, greedy) == pytest.approx(gains, rel=1e-5, abs=1e-3)


def test_what_stands_on_something_large_lays_nothing_bare() -> None:
    good = planning({"slab": 1.0, "cup": 1.0, "box": 1.0})
    seen = view([SLAB, CUP, BOX], good)
    by_xray = [c.name for c in order(seen, xray, np.random.default_rng(0))]
    assert by_xray == ["slab", "cup", "box"]
    assert names(seen, GREEDY) == ["slab", "box", "cup"]
    assert values(seen, GREEDY)["cup"] == 0.0


def test_what_it_does_not_try_may_hide_the_target() -> None:
    seen = view([SLAB, CUP, BOX], planning({"slab": 1.0, "box": 1.0}))
    config = Lookahead(candidates=1, beam=0)
    assert values(seen, config)["box"] == 0.0
    assert names(seen, config) == ["slab", "cup", "box"]  # as by X-Ray
    scores = config(seen, np.random.default_rng(0))
    assert scores.hides.all()


def test_two_steps_ahead_it_frees_what_cannot_be_grasped_yet() -> None:
    good = {"cup": 1.0, "box": 1.0}
    for freed, first in (({("slab", "cup"): 1.0}, "cup"), ({}, "box")):
        seen = view([SLAB, CUP, BOX], planning(good, freed))
        assert names(seen, GREEDY)[0] == "box"
        assert names(seen, Lookahead())[0] == first


def test_it_asks_no_more_than_it_may() -> None:
    blocks = [
        Block(f"{i}", 4 + 20 * (i // 5), 4 + 22 * (i % 5), 10, 10)
        for i in range(12)
    ]
    plan = planning({block.name: 1.0 for block in blocks})
    asked = []

    def infer(depth: np.ndarray, mask: np.ndarray) -> OccupancyDistribution:
        asked.append(depth)
        return hidden_places(depth, mask)

    seen = view(blocks, plan)
    assert seen.outlook is not None
    seen = replace(seen, outlook=replace(seen.outlook, infer=infer))
    Lookahead(candidates=5, beam=2, second=3)(seen, np.random.default_rng(0))
    assert len(asked) == 5 + 2 * 3


def test_a_target_that_can_be_grasped_ends_the_search() -> None:
    blocks = [SLAB, target_block(60, 60), BOX]
    qualities = {"slab": 1.0, "box": 1.0}
    free = view(blocks, planning({**qualities, TARGET: 0.3}))
    assert names(free, Lookahead())[0] == TARGET
    stuck = view(blocks, planning(qualities))
    assert names(stuck, Lookahead())[0] == "slab"
    assert values(stuck, GREEDY)[TARGET] == 0.0
