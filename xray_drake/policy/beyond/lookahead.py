"""Lookahead: which removal is expected to leave the least support."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from xray_drake.messages import OccupancyDistribution
from xray_drake.policy.beyond.chance import USUAL, chance
from xray_drake.policy.ranking import (
    Outlook,
    Planning,
    Scores,
    SearchView,
    highest_first,
    xray,
)
from xray_drake.policy.removal import Removal


@dataclass(frozen=True)
class Lookahead:
    """Scores objects by the expected decrease of the support.

    An object's removal is imagined (:class:`Removal`) and the distribution
    inferred again. With the chance that the grasp fails, all stays as it is.
    Otherwise the target comes into sight with the share of the distribution
    that lies where the removal lays the floor bare; then its silhouette is what
    is left of the support. If it does not, what was inferred is left.

    The most promising removals are followed by a second one. A limit of time
    would make rollouts irreproducible; the number of objects tried is limited
    instead, to ``candidates`` + ``beam`` × ``second`` inferences a decision.

    A target that can be grasped ends the search: it alone is scored then, by
    the whole support. Ties, and objects that are not tried, are ranked by
    X-Ray.

    Attributes:
        candidates: objects whose removal is imagined: those with the most of
            the distribution under them. One without any cannot shrink the
            support.
        beam: objects after whose removal a second is imagined, the most
            promising first; 0 looks one step ahead.
        second: second objects tried after each.
        later: what counts a decrease at the second step, in [0, 1]: of the
            supports after each of two steps, the first makes both smaller and
            the second one.
        low: a surface lower than this share of the target's thickness shows
            that the target is not there.
    """

    candidates: int = 6
    beam: int = 2
    second: int = 3
    later: float = 0.5
    low: float = 0.5

    def __call__(self, view: SearchView, rng: np.random.Generator) -> Scores:
        """Scores the candidates; see :class:`Ranking`.

        Raises:
            ValueError: the view has no outlook or cannot plan.
        """
        outlook, plan = view.foresight("lookahead")
        base = xray(view, rng)
        target = view.target if view.target in view.candidates else ""
        certain = chance(plan(target).grasp) if target else 0.0
        if certain > 0:
            values = {target: certain * view.occupancy.support_size()}
        else:
            values = self._values(view, outlook, plan)
        own = [[values.get(name, 0.0)] for name in view.candidates]
        return Scores(
            np.hstack([np.reshape(own, (-1, 1)), base.values]), base.hides
        )

    def _values(
        self, view: SearchView, outlook: Outlook, plan: Planning
    ) -> dict[str, float]:
        now = _Imagined(outlook, outlook.depth, view.occupancy)
        masks = {
            name: view.instances.mask(name)
            for name in view.candidates
            if name != view.target
        }
        tried = now.promising(masks)[: self.candidates]
        chances = {name: chance(plan(name).grasp) for name in tried}
        removals = {
            name: now.without(masks[name], self.low)
            for name in tried
            if chances[name] > 0
        }
        gains = {
            name: chances[name] * removal.decrease
            for name, removal in removals.items()
        }
        values = dict(gains)
        for name in _most_first(gains)[: self.beam]:
            # Where the grasp fails, the best of the others is next.
            others = [gains[other] for other in gains if other != name]
            values[name] += self.later * (
                chances[name]
                * self._following(removals[name], masks, name, chances, plan)
                + (1 - chances[name]) * max(others, default=0.0)
            )
        return values

    def _following(
        self,
        removal: "_Removed",
        masks: Mapping[str, np.ndarray],
        gone: str,
        chances: Mapping[str, float],
        plan: Planning,
    ) -> float:
        """Returns the expected decrease by the best second action.

        What cannot be grasped now perhaps can be when the first is gone.
        """
        left = {name: mask for name, mask in masks.items() if name != gone}
        after = removal.after
        best = 0.0
        for name in after.promising(left)[: self.second]:
            then = chances.get(name, USUAL)
            then = then or chance(plan(name, without=(gone,)).grasp)
            if then > 0:
                decrease = after.without(left[name], self.low).decrease
                best = max(best, then * decrease)
        hidden = 1 - removal.revealed
        return hidden * best + removal.revealed * USUAL * after.least


@dataclass(frozen=True)
class _Removed:
    """What is expected of a removal that succeeds.

    Attributes:
        after: what is seen if the target is not.
        revealed: the probability that it is.
        decrease: expected, of the support, pixels.
    """

    after: "_Imagined"
    revealed: float
    decrease: float


class _Imagined:
    """An image, and where the target can be in it.

    Attributes:
        size: of the support, pixels.
        least: what is left of it where the target is seen, pixels.
    """

    def __init__(
        self,
        outlook: Outlook,
        depth: np.ndarray,
        occupancy: OccupancyDistribution,
    ) -> None:
        self._outlook = outlook
        self._removal = Removal(depth, outlook.camera)
        self._mass = occupancy.supported()
        self.size = float(occupancy.support_size())
        scale = outlook.camera.floor_scale
        length, width, self._thickness = outlook.target_size
        self.least = min(scale**2 * length * width, self.size)

    def promising(self, masks: Mapping[str, np.ndarray]) -> list[str]:
        """Returns the objects over any of the distribution, most first."""
        sums = {
            name: float(self._mass[mask].sum(dtype=float))
            for name, mask in masks.items()
        }
        return _most_first({n: value for n, value in sums.items() if value > 0})

    def without(self, mask: np.ndarray, low: float) -> _Removed:
        """Imagines a removal."""
        depth, heights = self._removal.without(mask)
        outlook = self._outlook
        after = _Imagined(
            outlook, depth, outlook.infer(depth, outlook.target_mask)
        )
        bare = mask & (heights < low * self._thickness)
        whole = float(self._mass.sum(dtype=float))
        revealed = float(self._mass[bare].sum(dtype=float)) / max(whole, 1e-9)
        left = revealed * self.least + (1 - revealed) * min(
            after.size, self.size
        )
        return _Removed(after, revealed, self.size - left)


def _most_first(values: Mapping[str, float]) -> list[str]:
    names = list(values)
    column = np.reshape(list(values.values()), (-1, 1))
    return [names[i] for i in highest_first(column)]
