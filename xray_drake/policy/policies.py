"""The policies by name: a ranking, and what it must be given."""

from collections.abc import Mapping
from dataclasses import dataclass

from xray_drake.policy.beyond.grasp_aware import GraspAware
from xray_drake.policy.beyond.lookahead import Lookahead
from xray_drake.policy.oracle import oracle
from xray_drake.policy.ranking import RANKINGS, Ranking, xray


@dataclass(frozen=True)
class Policy:
    """What a policy consists of.

    Attributes:
        ranking: scores the objects.
        memory: the inference sees the depth image as remembered.
        outlook: the ranking imagines removals.
        truth: the ranking knows where the target is.
    """

    ranking: Ranking
    memory: bool = False
    outlook: bool = False
    truth: bool = False


POLICIES: Mapping[str, Policy] = {
    **{name: Policy(ranking) for name, ranking in RANKINGS.items()},
    "oracle": Policy(oracle, truth=True),
    "memory": Policy(xray, memory=True),
    "lookahead": Policy(Lookahead(), outlook=True),
    "grasp_aware": Policy(GraspAware(), outlook=True),
    "combined": Policy(GraspAware(Lookahead()), memory=True, outlook=True),
}
"""By the name that the scenario and the command line use. The first three are
the paper's."""
