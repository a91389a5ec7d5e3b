"""What has moved between two looks, and how far."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.policy.blocks import SCALE, Block, look
from xray_drake.policy.beyond.shifts import Look, Shift, renamed, shifts_seen

CUP = Block("cup", 40, 50, 9, 14)


def shifts(before: Look, after: Look, lifted: str = "") -> list[Shift]:
    return shifts_seen(
        before, after, SCALE, lifted=lifted, noise=0.002, least_pixels=3
    )


@settings(deadline=None, max_examples=40)
@given(st.integers(-35, 35), st.integers(-40, 40))
@example(0, 0)
def test_a_thing_that_slides_has_moved_by_its_way(
    down: int, right: int
) -> None:
    after = CUP.moved(down, right)
    found = shifts(look([CUP]), look([after]))
    if down == right == 0:
        assert found == []
        return
    (shift,) = found
    assert shift.distance == pytest.approx(np.hypot(down, right), abs=0.01)
    np.testing.assert_array_equal(shift.where, CUP.mask | after.mask)


@pytest.mark.parametrize("fall", [0.01, -0.01])
def test_a_thing_that_falls_has_moved_by_its_fall(fall: float) -> None:
    after = Block("cup", 40, 50, 9, 14, CUP.top - fall)
    (shift,) = shifts(look([CUP]), look([after]))
    assert shift.distance == pytest.approx(abs(fall) * SCALE, rel=1e-4)


def test_what_is_uncovered_or_covered_has_not_moved() -> None:
    book = Block("book", 20, 30, 50, 50, 0.01)
    assert shifts(look([book, CUP]), look([book]), lifted="cup") == []
    (shift,) = shifts(look([book, CUP]), look([book, CUP.moved(0, 6)]))
    np.testing.assert_array_equal(shift.where, CUP.mask | CUP.moved(0, 6).mask)


def test_what_covers_a_thing_does_not_add_to_its_way() -> None:
    book = Block("book", 20, 30, 30, 40, 0.01)
    on_its_end = Block("cup", 18, 60, 34, 20)
    before, after = (
        look([book, CUP.moved(20, 60)]),
        look([book.moved(0, 1), on_its_end]),
    )
    for one, other in ((before, after), (after, before)):
        ways = {s.name: s.distance for s in shifts(one, other)}
        assert ways["book"] == pytest.approx(1)


def test_only_what_was_lifted_may_go_unnoticed() -> None:
    assert shifts(look([CUP]), look([]), lifted="cup") == []
    (shift,) = shifts(look([CUP]), look([]), lifted="book")
    assert shift.distance == pytest.approx(np.hypot(9, 14))


def test_noise_and_specks_are_no_motion() -> None:
    before = look([CUP])
    rng = np.random.default_rng(0)
    noisy = before.depth + rng.uniform(-1e-3, 1e-3, before.depth.shape)
    noisy[42, 52:54] += 0.1
    assert shifts(before, Look(noisy, before.target, before.instances)) == []


@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan])
def test_what_has_no_reading_has_not_moved(nothing: float) -> None:
    before = look([CUP])
    depth = before.depth.copy()
    depth[CUP.mask] = nothing
    after = Look(depth, before.target, before.instances)
    assert shifts(before, after) == shifts(after, before) == []


def test_instances_are_known_by_their_places() -> None:
    book, pen = Block("b", 60, 20, 20, 20), Block("p", 10, 100, 4, 12)
    before = look([CUP, book, pen]).instances
    after = look(
        [
            Block("segment_0", 62, 23, 20, 20),  # the book, a little on
            Block("segment_1", 40, 50, 9, 14),  # the cup
            Block("segment_2", 10, 108, 4, 12),  # the pen, two thirds on
        ]
    ).instances
    named = renamed(before, after)
    assert named.names == ("b", "cup", "new segment_2")
    np.testing.assert_array_equal(named.labels, after.labels)
    assert renamed(before, after, gone="b").names[0] == "new segment_0"


def test_a_part_is_not_the_whole() -> None:
    halves = [Block(n, 40, c, 9, 7) for n, c in (("l", 50), ("r", 57))]
    before, after = look([CUP]).instances, look(halves).instances
    assert renamed(before, after).names == ("new l", "new r")
    assert renamed(after, before).names == ("new cup",)
