"""Grasp-aware: a target that is seen has to be freed for the gripper."""

from dataclasses import dataclass

import numpy as np

from xray_drake.policy.beyond.chance import chance
from xray_drake.policy.beyond.shifts import distance_to
from xray_drake.policy.ranking import (
    Outlook,
    Planning,
    Ranking,
    Scores,
    SearchView,
    xray,
)


@dataclass(frozen=True)
class GraspAware:
    """Scores objects by the grasp on the target that their removal allows.

    X-Ray's score says what hides the target. Once the target is seen but cannot
    be grasped, what matters is what blocks the gripper. So a grasp on the
    target is planned without each of the objects near it, and an object's score
    is one over the number of actions that it takes to remove the object and
    then to grasp the target, as expected from the chances of both grasps; the
    target's own is the chance of its grasp. Where no single removal makes a
    grasp possible, the object is next that takes most of the place of the
    target and of the fingers beside it. What is in the way so, or what X-Ray
    says hides the target, is worth a weak grasp.

    While the target is not a candidate, another ranking decides.

    Attributes:
        search: decides then.
        reach: objects seen within this distance of the target can be in the
            way, m: so far the gripper reaches from its grasp to any side.
        candidates: of these, so many are hypothetically removed, the nearest
            first.
        finger: clearance for a finger beside the target, m.
        probable: the target probably is where the distribution is above this.
        room: what a pixel of a finger's clearance counts; one of the target's
            place counts as the distribution says.
    """

    search: Ranking = xray
    reach: float = 0.06
    candidates: int = 6
    finger: float = 0.02
    probable: float = 0.5
    room: float = 0.5

    def __call__(self, view: SearchView, rng: np.random.Generator) -> Scores:
        """Scores the candidates; see :class:`Ranking`.

        Raises:
            ValueError: the view has no outlook or cannot plan.
        """
        outlook, plan = view.foresight("grasp_aware")
        if view.target not in view.candidates:
            return self.search(view, rng)
        values = self._values(view, outlook, plan)
        places = self._places(view, outlook)
        own = np.array(
            [[values.get(n, 0.0), places[n]] for n in view.candidates]
        )
        base = xray(view, rng)
        return Scores(
            np.hstack([own, base.values]), base.hides | (own > 0).any(axis=1)
        )

    def _values(
        self, view: SearchView, outlook: Outlook, plan: Planning
    ) -> dict[str, float]:
        target = view.target
        now = chance(plan(target).grasp)
        if now > 0:
            # Two actions are never worth more than one of at least one half.
            return {target: now}
        away = distance_to(view.instances.mask(target))
        distances = {
            name: float(away[view.instances.mask(name)].min())
            for name in view.candidates
            if name != target
        }
        near = [
            name
            for name in sorted(distances, key=lambda name: distances[name])
            if distances[name] <= self.reach * outlook.camera.floor_scale
        ]
        values = {}
        for name in near[: self.candidates]:
            first = chance(plan(name).grasp)
            then = (
                chance(plan(target, without=(name,)).grasp)
                if first > 0
                else 0.0
            )
            if then > 0:
                values[name] = 1 / (1 / first + 1 / then)
        return values

    def _places(self, view: SearchView, outlook: Outlook) -> dict[str, float]:
        """Returns how much of target's and fingers' places each takes."""
        rho = view.occupancy.supported()
        probable = (rho > self.probable) | outlook.target_mask
        room = distance_to(probable) <= self.finger * outlook.camera.floor_scale
        places = np.maximum(rho, self.room * room)
        return {
            name: float(places[view.instances.mask(name)].sum(dtype=float))
            * (name != view.target)
            for name in view.candidates
        }
