from dataclasses import replace

import numpy as np
import pytest

from xray_drake.inspector.replay import Replay
from xray_drake.inspector.snapshot import ranking_lines
from xray_drake.messages import Outcome, RankedCandidate, SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.testing.tiny import Observation


def test_the_first_snapshot_is_what_the_camera_sees(
    replay: Replay, recorded_observation: Observation, tiny_heap: Heap
) -> None:
    shot, seen = replay.snapshots[0], recorded_observation
    np.testing.assert_array_equal(shot.depth, seen.depth)
    np.testing.assert_array_equal(shot.seen_depth, seen.depth)
    assert set(shot.instances.names) == set(seen.label_of) - {"pad"}
    for name in shot.instances.names:
        np.testing.assert_array_equal(
            shot.instances.mask(name), seen.labels == seen.label_of[name]
        )
    for name, X_WO in tiny_heap.poses.items():
        np.testing.assert_allclose(shot.poses[name], X_WO, atol=1e-9)
    target = tiny_heap.target.name
    assert shot.target == target
    # One end of it peeps out from under the book.
    modal = shot.instances.mask(target)
    assert modal.any()
    assert modal.sum() < shot.target_amodal.sum()
    assert shot.target_amodal[modal].mean() > 0.95
    assert shot.color.shape == (384, 512, 3)
    assert shot.occupancy.support()[shot.target_amodal].mean() > 0.9


def test_it_holds_the_decision_and_what_became_of_it(replay: Replay) -> None:
    assert [shot.step for shot in replay.snapshots] == [1, 2]
    first, second = replay.snapshots
    assert first.action.grasp.object == "book"
    assert replay.record.actions[0].outcome is Outcome.LIFTED
    # What was lifted lies elsewhere then, and there the next look finds it.
    assert first.poses_after is not None
    moved = first.poses_after["book"][:3, 3] - first.poses["book"][:3, 3]
    assert np.linalg.norm(moved) > 0.1
    for name, X_WO in first.poses_after.items():
        np.testing.assert_allclose(second.poses[name], X_WO, atol=1e-3)
    # In the tote the camera does not see it, but it sees what lay under it.
    assert "book" not in second.instances.names
    assert "pad" in second.instances.names


def test_grasps_of_the_candidates_ranked_highest(replay: Replay) -> None:
    shot = replay.snapshots[0]
    assert set(shot.grasps) <= {c.name for c in shot.action.ranking}
    assert len(shot.grasps) > 1
    assert shot.grasps["book"] is shot.action.grasp
    for name, grasp in shot.grasps.items():
        assert grasp.object == name
        assert grasp.quality > 0


def test_a_ranking_in_words(replay: Replay) -> None:
    reason = "no grasp: jaw: 12 too wide, 3 hit mug_003; suction: 40 no seal"
    action = replace(
        replay.snapshots[0].action,
        ranking=(
            RankedCandidate("cup", 4.0, False, reason),
            RankedCandidate("book", 2.5, True),
            *(RankedCandidate(f"pad_{k}", 0.125, False) for k in range(3)),
        ),
    )
    lines = ranking_lines(action, most=4)
    assert max(map(len, lines)) <= 72
    assert " ".join(map(str.strip, lines[:2])) == f"1. cup, score 4: {reason}"
    kind = action.grasp.kind.value
    assert lines[2:] == (
        f"2. book, score 2.5: by {kind}",
        "3. pad_0, score 0.125",
        "4. pad_1, score 0.125",
        "and 1 more",
    )
    assert ranking_lines(SearchAction(1)) == ()


@pytest.mark.parametrize(
    ("scores", "shares"),
    [
        ((5.0, 3.0, 1.0), [1.0, 0.5, 0.0]),
        ((2.0, -2.0), [1.0, 0.0]),
        ((0.0, 0.0), [1.0, 1.0]),
        ((), []),
    ],
)
def test_relative_scores(
    replay: Replay, scores: tuple[float, ...], shares: list[float]
) -> None:
    ranking = tuple(
        RankedCandidate(f"object_{k}", score, hides=True)
        for k, score in enumerate(scores)
    )
    shot = replay.snapshots[0]
    shot = replace(shot, action=replace(shot.action, ranking=ranking))
    assert list(shot.relative_scores().values()) == shares
