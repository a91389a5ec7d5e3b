"""What a benchmark compares: policies, each with an inference."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from xray_drake.choices import current_occupancy
from xray_drake.policy.registry import POLICIES, PolicyError
from xray_drake.station.scenario import Scenario

_FIRST = ("random", "largest", "xray")
_LAST = ("oracle",)


@dataclass(frozen=True)
class Variant:
    """A policy, and what it works with.

    Attributes:
        policy: name of its ranking.
        occupancy: what infers the distribution; empty where the policy does
            not look at it.
        target_first: it grasps the target whenever it can.
    """

    policy: str
    occupancy: str = ""
    target_first: bool = True

    @classmethod
    def make(cls, policy: str, occupancy: str, target_first: bool) -> "Variant":
        """Returns a variant; the inference is left out where none is used."""
        try:
            blind = POLICIES[policy].blind
        except PolicyError:  # that of a record, which is not installed here
            blind = False
        used = "" if blind else current_occupancy(occupancy)
        return cls(policy, used, target_first)

    @classmethod
    def of(cls, record: dict[str, Any]) -> "Variant":
        """Returns the variant that a rollout's record is of."""
        return cls.make(
            record["policy"],
            record.get("occupancy", ""),
            record.get("target_first", True),
        )

    def applied_to(self, scenario: Scenario) -> Scenario:
        """Returns a scenario with this policy, and this inference if any."""
        perception = scenario.perception
        if self.occupancy:
            perception = replace(perception, occupancy=self.occupancy)
        return replace(
            scenario,
            policy=replace(
                scenario.policy,
                name=self.policy,
                target_first=self.target_first,
            ),
            perception=perception,
        )

    @property
    def label(self) -> str:
        """What reports call it."""
        notes = [self.occupancy] if self.occupancy else []
        if not self.target_first:
            notes.append("target not first")
        return f"{self.policy} ({', '.join(notes)})" if notes else self.policy

    @property
    def order(self) -> tuple[int, str, str, bool]:
        """What variants are sorted by: the paper's first, references last."""
        rank = len(_FIRST) + (self.policy in _LAST)
        if self.policy in _FIRST:
            rank = _FIRST.index(self.policy)
        return rank, self.policy, self.occupancy, not self.target_first


def variants(
    policies: Sequence[str],
    occupancies: Sequence[str],
    *,
    target_first: bool = True,
) -> tuple[Variant, ...]:
    """Combines policies and inferences, each combination once.

    Args:
        policies: names of rankings.
        occupancies: what infers the distribution.
        target_first: see :class:`Variant`.
    """
    return tuple(
        dict.fromkeys(
            Variant.make(policy, occupancy, target_first)
            for policy in policies
            for occupancy in occupancies
        )
    )
