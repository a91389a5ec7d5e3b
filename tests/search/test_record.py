import json
from pathlib import Path

import numpy as np

from xray_drake.messages import Grasp, GraspKind, Outcome, RankedCandidate
from xray_drake.search.record import (
    ActionRecord,
    SearchRecord,
    write_record,
)

X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
X_WG[:3, 3] = 0.1, np.pi / 10, 0.02
ACTION = ActionRecord(
    step=1,
    object="book",
    is_target=False,
    grasp=Grasp(GraspKind.JAW, "book", X_WG, width=0.03, quality=0.9),
    outcome=Outcome.SLIPPED,
    reason="the vacuum is gone",
    duration=4.5,
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
AS_JSON = {
    "step": 1,
    "object": "book",
    "segment": "segment_3",
    "is_target": False,
    "grasp": {
        "kind": "jaw",
        "X_WG": [
            *([1, 0, 0, 0.1], [0, -1, 0, 0.314159]),
            *([0, 0, -1, 0.02], [0, 0, 0, 1]),
        ],
        "width": 0.03,
        "quality": 0.9,
    },
    "outcome": "slipped",
    "reason": "the vacuum is gone",
    "lifted": [],
    "duration": 4.5,
    "score": 123.456,
    "support_before": 700,
    "support_after": 300,
    "support_01_before": 600,
    "support_01_after": 200,
    "target_visible_fraction": 0.1235,
    "true_mask_in_support": 0.97,
    "seconds": {"occupancy": 0.0301, "planning": 0.2},
    "ranking": [
        {
            "object": "cup",
            "score": 3.1416,
            "hides": True,
            "passed_over": "jaw: 7 × too wide",
        },
        {"object": "book", "score": 1.5, "hides": False, "passed_over": ""},
    ],
}
PROVENANCE = {
    *("versions", "commit", "dirty", "code", "weights", "dtype", "processor"),
    "date",
}


def record(end: str) -> SearchRecord:
    return SearchRecord(
        horizon=10,
        policy="xray",
        occupancy="geometric",
        execution="quasi_static",
        seed=5,
        target="lid",
        objects=["book", "cup"],
        start={"target_visible_fraction": 0.25, "num_dropped": 3},
        actions=[ACTION, ACTION],
        end=end,
        target_first=False,
    )


def test_the_record_is_as_documented() -> None:
    data = record("horizon").to_dict()
    made_by = {key: data.pop(key) for key in PROVENANCE}
    assert {"xray_drake", "drake", "numpy"} <= set(made_by["versions"])
    assert all(isinstance(v, str) for v in made_by["versions"].values())
    assert data == {
        "success": False,
        "num_actions": 2,
        "horizon": 10,
        "policy": "xray",
        "target_first": False,
        "occupancy": "geometric",
        "execution": "quasi_static",
        "seed": 5,
        "target": "lid",
        "objects": ["book", "cup"],
        "start": {"target_visible_fraction": 0.25, "num_dropped": 3},
        "actions": [AS_JSON, AS_JSON],
        "end": "horizon",
        "scenario": "",
    }


def test_no_grasp_is_null() -> None:
    action = ActionRecord(1, "", False, Grasp(), Outcome.NO_GRASP).to_dict()
    assert action["outcome"] == "no_grasp"
    assert set(action["grasp"]) == set(AS_JSON["grasp"])
    assert action["grasp"]["kind"] is action["grasp"]["X_WG"] is None


def test_the_file_is_json(tmp_path: Path) -> None:
    path = tmp_path / "rollout.json"
    wanted = record("success")
    write_record(wanted, path)
    text = path.read_text(encoding="utf-8")
    assert text.endswith("}\n")
    assert json.loads(text) == wanted.to_dict()
    assert wanted.success
