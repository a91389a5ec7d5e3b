"""The record of one rollout, and its JSON file (DESIGN.md)."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from xray_drake.files import write_whole_file
from xray_drake.messages import Grasp, Outcome, RankedCandidate
from xray_drake.provenance import Provenance, current


@dataclass
class ActionRecord:
    """One action of a rollout.

    Attributes:
        step: 1, 2, ….
        object: what was grasped, by the name that the body truly has; empty
            where there was no grasp, or nothing under it.
        is_target: what was grasped was taken for the target.
        grasp: as planned.
        outcome: how it ended; NONE while it goes on.
        reason: why it failed, one line.
        lifted: what really left the bin for the tote, or was on its way there
            when the search ended.
        duration: from the decision to the end of the action, simulated s.
        score: of the object in the ranking.
        support_before: |supp ρ| when it was decided, pixels.
        support_after: the same after it; −1 while it goes on.
        support_01_before: number of pixels with ρ > 0.1 when it was decided.
        support_01_after: the same after it.
        target_visible_fraction: visible share of the target's amodal mask when
            it was decided.
        true_mask_in_support: share of the target's true amodal mask that lay
            in the support when it was decided.
        seconds: wall time per stage.
        segment: what was grasped, by the name that the segmenter gave it; with
            ground truth the body's own.
        ranking: candidates in the order of preference, and why some were
            passed over.
    """

    step: int
    object: str
    is_target: bool
    grasp: Grasp
    outcome: Outcome = Outcome.NONE
    reason: str = ""
    lifted: tuple[str, ...] = ()
    duration: float = 0.0
    score: float = 0.0
    support_before: int = 0
    support_after: int = -1
    support_01_before: int = 0
    support_01_after: int = -1
    target_visible_fraction: float = 0.0
    true_mask_in_support: float = 0.0
    seconds: dict[str, float] = field(default_factory=dict)
    segment: str = ""
    ranking: tuple[RankedCandidate, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Returns the action as JSON takes it."""
        grasp = self.grasp
        return vars(self) | {
            "grasp": {
                "kind": grasp.kind.value if grasp else None,
                "X_WG": np.round(grasp.X_WG, 6).tolist() if grasp else None,
                "width": round(grasp.width, 6),
                "quality": round(grasp.quality, 6),
            },
            "outcome": self.outcome.value,
            "lifted": list(self.lifted),
            "duration": round(self.duration, 3),
            "score": round(self.score, 4),
            "target_visible_fraction": round(self.target_visible_fraction, 4),
            "true_mask_in_support": round(self.true_mask_in_support, 4),
            "seconds": {k: round(v, 4) for k, v in self.seconds.items()},
            "ranking": [
                {
                    "object": candidate.name,
                    "score": round(candidate.score, 4),
                    "hides": candidate.hides,
                    "passed_over": candidate.passed_over,
                }
                for candidate in self.ranking
            ],
        }


@dataclass
class SearchRecord:
    """One rollout.

    Attributes:
        horizon: actions at most.
        policy, occupancy, execution: what was used.
        policy_source: where a policy comes from that is not the package's own;
            of the others the record does not tell.
        seed: of the scenario.
        target: its name.
        objects: names of the distractors in the bin at the start.
        start: the heap at the start: ``target_tilt_deg``, ``num_dropped``,
            ``attempts``, ``redrawn`` (see :class:`xray_drake.scene.heap.Heap`);
            from the first decision on ``target_visible_fraction`` as the
            detector has it, and, as the truth is, ``target_pixels`` (of the
            amodal mask), ``cover_pixels``, ``cover_fraction``, ``num_covers``
            (see :class:`xray_drake.station.start.TargetView`).
        actions: in order.
        end: "success", "horizon", "target_lost", "nothing_graspable";
            "interrupted" where it was stopped; empty while it goes on.
        target_first: the policy grasps the target whenever it can.
        scenario: as YAML, whatever differs from the defaults; the search can
            be run again from it.
        provenance: what made it; its keys are the record's.
    """

    horizon: int
    policy: str
    occupancy: str
    execution: str
    seed: int
    target: str
    objects: list[str]
    start: dict[str, float] = field(default_factory=dict)
    actions: list[ActionRecord] = field(default_factory=list)
    end: str = ""
    target_first: bool = True
    scenario: str = ""
    policy_source: str = ""
    provenance: Provenance = field(default_factory=current)

    @property
    def success(self) -> bool:
        """The target was lifted clear of the bin; by contact, to the tote."""
        return self.end == "success"

    @property
    def num_actions(self) -> int:
        """Actions spent, the one that lifted the target included."""
        return len(self.actions)

    @property
    def num_done(self) -> int:
        """Actions that have ended."""
        return sum(a.outcome is not Outcome.NONE for a in self.actions)

    def to_dict(self) -> dict[str, Any]:
        """Returns the record as JSON takes it."""
        data: dict[str, Any] = {
            "success": self.success,
            "num_actions": self.num_actions,
            **vars(self),
            "start": {k: round(v, 4) for k, v in self.start.items()},
            "actions": [action.to_dict() for action in self.actions],
        }
        if not self.policy_source:
            del data["policy_source"]
        provenance = data.pop("provenance")
        return data | provenance.to_dict()


def write_record(record: SearchRecord, path: Path) -> None:
    """Writes a record as JSON.

    Raises:
        OSError: the file cannot be written.
    """
    text = json.dumps(record.to_dict(), indent=1) + "\n"
    write_whole_file(path, text.encode())
