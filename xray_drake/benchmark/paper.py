"""The paper's own figures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperRow:
    """A row of the paper's Table II: 1,000 simulated heaps.

    Attributes:
        rate: share of successes.
        quartiles: of the number of actions over successes.
    """

    rate: float
    quartiles: tuple[int, int, int]


TABLE_II = {
    "random": PaperRow(0.42, (4, 7, 9)),
    "largest": PaperRow(0.67, (4, 5, 7)),
    "xray": PaperRow(0.82, (3, 5, 6)),
}
"""By the name of the policy. Its X-Ray works with a network."""
