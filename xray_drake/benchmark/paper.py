"""The paper's own figures."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PaperRow:
    """A policy in the paper.

    Attributes:
        rate: share of successes.
        quartiles: of the number of actions over successes.
    """

    rate: float
    quartiles: tuple[float, float, float]


@dataclass(frozen=True)
class PaperTable:
    """One of the paper's tables of policies.

    Attributes:
        name: as the paper counts it.
        heaps: how many.
        what: they were.
        rows: by the name of the policy; its X-Ray works with a network.
    """

    name: str
    heaps: int
    what: str
    rows: Mapping[str, PaperRow]


TABLE_II = PaperTable(
    "Table II",
    1000,
    "simulated heaps of its own objects and physics",
    {
        "random": PaperRow(0.42, (4, 7, 9)),
        "largest": PaperRow(0.67, (4, 5, 7)),
        "xray": PaperRow(0.82, (3, 5, 6)),
    },
)
TABLE_III = PaperTable(
    "Table III",
    20,
    "heaps before a real robot",
    {
        "random": PaperRow(0.85, (4, 6, 7)),
        "largest": PaperRow(0.85, (4, 6, 7)),
        "xray": PaperRow(1.00, (4, 5, 5.25)),
    },
)


def paper_table(scenario: str) -> PaperTable:
    """Returns the paper's table that a scenario is modelled on."""
    return TABLE_III if scenario == "table3" else TABLE_II
