"""What is remembered of earlier looks, by the laws of the bin."""

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.policy.blocks import (
    CAMERA_HEIGHT,
    FLOOR,
    SCALE,
    SHAPE,
    TARGET,
    TARGET_SIZE,
    Block,
    heights_of,
    look,
    overhead_camera,
    target_block,
)
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.policy.beyond.memory import Belief, TargetMemory
from xray_drake.policy.beyond.shifts import Look
from xray_drake.scene.targets import target_model

CAMERA = overhead_camera()
CUP = Block("cup", 30, 30, 12, 12)
BOOK = Block("book", 62, 88, 14, 14)


def remember(
    *looks: Look,
    lifted: str = "",
    slipped: str = "",
    **numbers: Any,
) -> Belief:
    """Returns the belief after looks; lifting comes before the last."""
    memory = TargetMemory(TARGET_SIZE, FLOOR, **numbers)
    belief = Belief()
    for i, seen in enumerate(looks):
        last = i == len(looks) - 1
        touched = {"lifted": lifted, "slipped": slipped} if last else {}
        belief = memory.update(belief, seen, CAMERA, **touched)
    return belief


def recalled_depth(belief: Belief) -> np.ndarray:
    return TargetMemory(TARGET_SIZE, FLOOR).recall(belief, CAMERA)


def test_the_first_look_is_what_is_seen() -> None:
    seen = look([CUP, BOOK, target_block(44, 40)])
    belief = remember(seen)
    assert not belief.recalled.any()
    np.testing.assert_array_equal(recalled_depth(belief), seen.depth)


def test_what_shifts_over_free_floor_hides_nothing() -> None:
    """The case that the paper leaves to memory (section VI)."""
    after = CUP.moved(0, 40)
    belief = remember(look([CUP, BOOK]), look([after, BOOK]))
    heights = heights_of(recalled_depth(belief))
    np.testing.assert_allclose(heights[after.mask], 0.0, atol=1e-6)
    np.testing.assert_allclose(heights[BOOK.mask], BOOK.top, atol=1e-6)
    # Where it has no reading, too.
    now = look([after, BOOK])
    depth = now.depth.copy()
    depth[after.mask] = np.tile([np.nan, 0.0, CAMERA_HEIGHT - 0.03], 48)
    unread = Look(depth, now.target, now.instances)
    heights = heights_of(recalled_depth(remember(look([CUP, BOOK]), unread)))
    np.testing.assert_allclose(heights[after.mask], 0.0, atol=1e-6)


def test_what_was_never_seen_free_is_as_it_looks() -> None:
    """The book lay where the cup is now, and leant there on the target."""
    over = Block("book", 30, 60, 14, 14)
    after = CUP.moved(0, 32)
    belief = remember(look([CUP, over]), look([after]), lifted="book")
    np.testing.assert_array_equal(
        recalled_depth(belief)[over.mask], look([after]).depth[over.mask]
    )


@st.composite
def searches(draw: st.DrawFn) -> tuple[Block, list[list[Block]]]:
    """Blocks that jump about, and a target that stays."""

    def place(name: str, rows: int, columns: int) -> Block:
        row, column = draw(st.integers(14, 70)), draw(st.integers(22, 95))
        return Block(name, row, column, rows, columns)

    target = target_block(draw(st.integers(25, 60)), draw(st.integers(35, 80)))
    sizes = draw(
        st.lists(
            st.tuples(st.integers(3, 20), st.integers(3, 20)),
            min_size=1,
            max_size=4,
        )
    )
    scenes = [
        [place(str(i), *size) for i, size in enumerate(sizes)] for _ in range(3)
    ]
    return target, scenes


@settings(deadline=None, max_examples=30)
@given(searches(), st.floats(0.0, 1.0))
def test_a_target_that_stays_is_never_ruled_out(
    search: tuple[Block, list[list[Block]]], share: float
) -> None:
    target, scenes = search
    looks = [look([target, *blocks]) for blocks in scenes]
    belief = remember(*looks, share=share, drag=0.0, margin=0.0)
    assert not (belief.empty & target.mask).any()


@settings(deadline=None, max_examples=30)
@given(
    st.integers(-20, 20),
    st.integers(-30, 30),
    st.sampled_from([0.25, 0.5, 1.0]),
)
def test_a_target_that_is_dragged_along_is_not_ruled_out(
    down: int, right: int, share: float
) -> None:
    """It follows what covers it over the share of its way."""
    target = target_block(42, 55)
    cover = Block("cover", 38, 50, 13, 20)
    far = Block("far", 15, 25, 12, 12)
    dragged = target.moved(int(share * down), int(share * right))
    shadow = cover.moved(down, right)
    # Something lies over it wherever it is: it is not seen again.
    lid = Block("lid", dragged.row - 1, dragged.column - 1, 7, 12, 0.05)
    belief = remember(
        look([target, cover, far]),
        look([dragged, shadow, far, lid]),
        share=share,
        drag=0.0,
        margin=0.0,
    )
    assert not (belief.recalled & dragged.mask).any()


def test_the_more_it_may_be_dragged_the_less_is_remembered() -> None:
    looks = look([CUP, BOOK]), look([CUP.moved(3, 9), BOOK])
    sizes = []
    for share in (0.0, 0.25, 0.5, 1.0):
        belief = remember(*looks, share=share)
        sizes.append(np.count_nonzero(belief.recalled))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > sizes[1] > sizes[-1]


def test_what_is_lifted_may_have_dragged_it() -> None:
    before, after = look([CUP, BOOK]), look([BOOK])
    free = remember(before, after, lifted="cup").recalled
    drag = TargetMemory.drag * SCALE
    rows, columns = np.nonzero(CUP.mask)
    for row, column in np.argwhere(remember(before).empty).tolist():
        away = np.hypot(rows - row, columns - column).min()
        # Its place and its margin, and so far around them.
        margin = TargetMemory.margin * SCALE
        if away <= drag:
            assert not free[row, column]
        elif away > drag + margin + 1.5:
            assert free[row, column]


def test_the_same_look_again_teaches_nothing() -> None:
    looks = look([CUP, BOOK]), look([CUP.moved(5, 20), BOOK])
    once, twice = remember(*looks), remember(*looks, looks[-1])
    np.testing.assert_array_equal(once.empty, twice.empty)


def test_a_target_once_seen_is_not_elsewhere() -> None:
    target = target_block(40, 60)
    before = look([target, CUP, BOOK, Block("lid", 38, 64, 12, 12)])
    assert before.target.any()
    fallen = CUP.moved(10, 29)  # over what was seen of it
    after = look([target, fallen, BOOK, Block("lid", 38, 64, 12, 12)])
    assert not after.target.any()
    belief = remember(before, after)
    heights = heights_of(recalled_depth(belief))
    assert (heights[BOOK.mask] < 1e-6).all()
    assert (heights[target.mask] > 0.004).all()


def test_all_of_a_target_is_within_its_length_of_what_is_seen() -> None:
    target = target_block(40, 60)
    for lid in (
        Block("lid", 39, 61, 7, 10),  # one end peeps out
        Block("lid", 41, 59, 6, 12),  # one side does
    ):
        seen = look([target, lid, BOOK])
        assert 0 < np.count_nonzero(seen.target) <= 10
        empty = remember(seen).empty
        assert not (empty & target.mask).any()
        assert empty[BOOK.mask].all()


def test_a_target_that_is_seen_to_move_moves_all_its_way() -> None:
    """From beside a lid to under it, by 20 pixels."""
    target, lid = target_block(40, 40), Block("lid", 36, 58, 14, 16)
    before, after = look([target, lid]), look([target.moved(0, 20), lid])
    assert not after.target.any()
    belief = remember(before, after, drag=0.0, margin=0.0)
    assert not (belief.recalled & target.moved(0, 20).mask).any()


def test_a_target_that_slips_may_be_anywhere() -> None:
    before = look([target_block(40, 40), CUP, BOOK])
    after = look([target_block(60, 90), CUP, BOOK])
    assert not remember(before, after, slipped=TARGET).recalled.any()
    assert remember(before, after, slipped="cup").recalled.any()


def test_a_target_seen_where_it_should_not_be_is_believed() -> None:
    target = target_block(20, 90)
    before = look([CUP, BOOK])
    after = look([CUP, BOOK, target, Block("lid", 18, 95, 10, 12)])
    assert (remember(before).empty & target.mask).any()
    belief = remember(before, after, share=0.0, drag=0.0)
    assert not (belief.recalled & target.mask).any()
    assert belief.recalled[CUP.row - 5, CUP.column]  # far away it holds


def test_where_no_room_is_left_it_forgets() -> None:
    belief = remember(look([]), look([CUP]))
    assert not belief.recalled.any()
    np.testing.assert_array_equal(recalled_depth(belief), look([CUP]).depth)


def test_the_inference_excludes_what_is_remembered() -> None:
    """A plate hides a target on the floor, but not where the floor was seen."""
    target = target_model("box_2to1")
    memory = TargetMemory(target.extents, FLOOR)
    plate, other = (
        Block("plate", 25, 30, 18, 20, 0.02),
        Block("other", 60, 85, 18, 20, 0.02),
    )
    moved = plate.moved(0, 40)
    belief = Belief()
    for blocks in ([plate, other], [moved, other]):
        belief = memory.update(belief, look(blocks), CAMERA)
    inference = GeometricInference(target, GeometricConfig(rotations=8))
    seen, known = (
        inference.infer(depth, np.zeros(SHAPE, bool), CAMERA).support()
        for depth in (look([moved, other]).depth, memory.recall(belief, CAMERA))
    )
    assert seen[moved.mask].mean() > 0.9
    assert not known[moved.mask].any()
    np.testing.assert_array_equal(known[~moved.mask], seen[~moved.mask])


def test_names_that_do_not_last_are_not_needed() -> None:
    """What stays is known by its place, whatever it is called."""
    after = CUP.moved(0, 3)
    named = remember(look([CUP, BOOK]), look([after, BOOK]))
    swapped = [
        replace(BOOK, name="segment_0"),
        replace(after, name="segment_1"),
    ]
    first = [replace(CUP, name="segment_0"), replace(BOOK, name="segment_1")]
    by_place = remember(look(first), look(swapped), names_last=False)
    assert named.recalled.any()
    np.testing.assert_array_equal(by_place.recalled, named.recalled)
    mistaken = remember(look(first), look(swapped))
    assert mistaken.recalled.sum() < named.recalled.sum()
