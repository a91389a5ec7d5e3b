import json
from pathlib import Path

import numpy as np
import pytest

from xray_drake.messages import Grasp, GraspKind, Outcome, RankedCandidate
from xray_drake.search.record import (
    ActionRecord,
    SearchRecord,
    write_record,
)

RECORD_KEYS = {
    *("success", "num_actions", "horizon", "policy", "occupancy", "execution"),
    *("seed", "target", "objects", "actions", "end", "versions"),
    # Where it comes from.
    *("commit", "dirty", "code", "weights", "dtype", "processor", "date"),
}
ACTION_KEYS = {
    *("step", "object", "is_target", "grasp", "outcome", "score"),
    *("support_before", "support_after", "support_01_before"),
    *("support_01_after", "target_visible_fraction", "seconds"),
}
GRASP_KEYS = {"kind", "X_WG", "width", "quality"}
"""As DESIGN.md has them."""

OUR_RECORD_KEYS = {"start", "target_first", "dtype", "scenario"}
OUR_ACTION_KEYS = {
    "reason",
    "true_mask_in_support",
    "lifted",
    "duration",
    "segment",
    "ranking",
}
"""Beyond those; documented in the classes."""


def jaw_action(
    step: int = 1, outcome: Outcome = Outcome.LIFTED
) -> ActionRecord:
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = 0.1, np.pi / 10, 0.02
    return ActionRecord(
        step=step,
        object="book",
        is_target=False,
        grasp=Grasp(GraspKind.JAW, "book", X_WG, width=0.03, quality=0.9),
        outcome=outcome,
        score=float(np.float32(123.456)),
        support_before=700,
        support_after=300,
        support_01_before=600,
        support_01_after=200,
        target_visible_fraction=0.123456,
        true_mask_in_support=0.97,
        seconds={"occupancy": 0.0301234, "planning": 0.2},
        segment="segment_3",
        ranking=(
            RankedCandidate("cup", np.pi, True, "jaw: 7 × too wide"),
            RankedCandidate("book", 1.5, False),
        ),
    )


def record(*actions: ActionRecord, end: str = "horizon") -> SearchRecord:
    return SearchRecord(
        horizon=10,
        policy="xray",
        occupancy="geometric",
        execution="quasi_static",
        seed=5,
        target="lid",
        objects=["book", "cup"],
        start={"target_visible_fraction": 0.25, "num_dropped": 3},
        actions=list(actions),
        end=end,
        target_first=False,
    )


def test_keys_of_the_record() -> None:
    data = record(jaw_action()).to_dict()
    assert set(data) == RECORD_KEYS | OUR_RECORD_KEYS
    (action,) = data["actions"]
    assert set(action) == ACTION_KEYS | OUR_ACTION_KEYS
    assert set(action["grasp"]) == GRASP_KEYS
    assert {"xray_drake", "drake", "numpy"} <= set(data["versions"])
    assert all(isinstance(v, str) for v in data["versions"].values())


def test_values_of_the_record() -> None:
    data = record(jaw_action(), jaw_action(2, Outcome.SLIPPED)).to_dict()
    assert (data["success"], data["num_actions"]) == (False, 2)
    assert (data["policy"], data["occupancy"]) == ("xray", "geometric")
    assert (data["execution"], data["seed"]) == ("quasi_static", 5)
    assert (data["target"], data["objects"]) == ("lid", ["book", "cup"])
    assert (data["horizon"], data["end"]) == (10, "horizon")
    assert data["target_first"] is False
    first, second = data["actions"]
    assert (first["step"], second["step"]) == (1, 2)
    assert (first["outcome"], second["outcome"]) == ("lifted", "slipped")
    assert first["grasp"]["kind"] == "jaw"
    np.testing.assert_allclose(
        first["grasp"]["X_WG"], jaw_action().grasp.X_WG, atol=1e-6
    )
    assert first["score"] == pytest.approx(123.456)
    assert (first["support_before"], first["support_after"]) == (700, 300)
    assert (first["support_01_before"], first["support_01_after"]) == (600, 200)
    assert first["true_mask_in_support"] == 0.97
    assert (first["object"], first["segment"]) == ("book", "segment_3")
    assert first["seconds"]["planning"] == 0.2
    assert first["ranking"] == [
        {
            "object": "cup",
            "score": 3.1416,
            "hides": True,
            "passed_over": "jaw: 7 × too wide",
        },
        {"object": "book", "score": 1.5, "hides": False, "passed_over": ""},
    ]


def test_no_grasp_is_null() -> None:
    action = ActionRecord(1, "", False, Grasp(), Outcome.NO_GRASP)
    grasp = action.to_dict()["grasp"]
    assert set(grasp) == GRASP_KEYS
    assert grasp["kind"] is None
    assert grasp["X_WG"] is None
    assert action.to_dict()["outcome"] == "no_grasp"


@pytest.mark.parametrize(
    ("end", "success"),
    [
        ("success", True),
        ("horizon", False),
        ("target_lost", False),
        ("nothing_graspable", False),
        ("interrupted", False),
        ("", False),
    ],
)
def test_success_is_one_of_the_ends(end: str, success: bool) -> None:
    assert record(end=end).to_dict()["success"] is success


def test_the_file_is_json(tmp_path: Path) -> None:
    path = tmp_path / "rollout.json"
    wanted = record(jaw_action(), end="success")
    write_record(wanted, path)
    text = path.read_text(encoding="utf-8")
    assert text.endswith("}\n")
    assert json.loads(text) == wanted.to_dict()
    assert [p.name for p in tmp_path.iterdir()] == ["rollout.json"]


def test_a_folder_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"):
        write_record(record(), tmp_path / "nowhere" / "x.json")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "x.json").mkdir()
    with pytest.raises(OSError, match=r"x\.json"):
        write_record(record(), tmp_path / "x.json")
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
