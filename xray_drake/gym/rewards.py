"""What an action was worth: the paper's two rewards, and target visibility."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class SearchState:
    """What rewards look at, between two actions.

    Attributes:
        support: |supp ρ|, pixels.
        visible_fraction: visible share of the target's amodal mask.
        success: the target has been lifted from the bin.
    """

    support: int
    visible_fraction: float
    success: bool = False


def sparse(before: SearchState, after: SearchState) -> float:
    """R: 1 if the target was lifted from the bin, else 0 (paper III.B)."""
    return float(after.success)


def surrogate(before: SearchState, after: SearchState) -> float:
    """R̃: the decrease of the support, pixels (paper section III.D)."""
    return float(before.support - after.support)


def visibility(before: SearchState, after: SearchState) -> float:
    """The increase of the target's visible share.

    The paper proposes "a reward of target object visibility" and gives no
    formula. Here a target that is lifted counts as fully visible, so over a
    search that succeeds the rewards sum to 1 − the share at the start.
    """
    return after.visible_fraction - before.visible_fraction


Reward = Callable[[SearchState, SearchState], float]
"""The state before and after an action to what the action was worth."""

REWARDS: Mapping[str, Reward] = {
    "sparse": sparse,
    "surrogate": surrogate,
    "visibility": visibility,
}
"""By the name that the environment uses."""


def discounted_return(rewards: Iterable[float], gamma: float) -> float:
    """Returns Σ γᵏ rₖ, k from 0 (paper section III.C)."""
    return float(sum(gamma**k * r for k, r in enumerate(rewards)))
