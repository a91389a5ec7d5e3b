"""Agents that need no training: any mask, X-Ray, and other policies."""

from collections.abc import Callable, Mapping

import numpy as np

from xray_drake.messages import (
    InstanceMasks,
    OccupancyDistribution,
    TargetMask,
)
from xray_drake.perception.ground_truth import target_instance
from xray_drake.policy.ranking import SearchView, order
from xray_drake.policy.registry import POLICIES, PolicyError

Observation = Mapping[str, np.ndarray]


def random_agent(observation: Observation, rng: np.random.Generator) -> int:
    """Chooses any of the valid masks; any mask at all where none is."""
    valid = np.flatnonzero(observation["action_mask"])
    return int(rng.choice(valid)) if len(valid) else 0


def policy_agent(name: str, *, target_first: bool = True) -> Callable[..., int]:
    """Returns an agent that chooses as a policy ranks.

    On the same heap it does what the policy does, while a valid mask hides some
    of the target: where none does, the policy takes a weak grasp on what hides
    it, which is not among the valid ones.

    Args:
        name: of the policy, one of
            :data:`~xray_drake.policy.registry.POLICIES`.
        target_first: grasp the target whenever that is valid.

    Returns:
        An observation, and optionally a random generator, to an action. The
        observation must have ``occupancy`` and ``support``: make the
        environment with ``observe_occupancy=True``.

    Raises:
        PolicyError: no such policy, or one that needs more than an observation
            holds.
    """
    policy = POLICIES[name]
    if policy.memory or policy.outlook or policy.truth:
        raise PolicyError(
            f"the policy {name!r} needs more than an observation holds: choose "
            "one without memory, outlook and truth"
        )

    def agent(
        observation: Observation, rng: np.random.Generator | None = None
    ) -> int:
        labels = np.asarray(observation["instances"])
        names = tuple(str(i) for i in range(labels.max(initial=-1) + 1))
        instances = InstanceMasks(labels, names)
        valid = np.flatnonzero(observation["action_mask"])
        rho = np.where(observation["support"], observation["occupancy"], 0)
        target = target_instance(
            instances, TargetMask(observation["target_mask"])
        )
        view = SearchView(
            OccupancyDistribution(rho),
            instances,
            tuple(str(i) for i in valid),
            target,
        )
        ranked = order(
            view,
            policy.ranking,
            rng or np.random.default_rng(0),
            target=target if target_first else "",
        )
        return int(ranked[0].name) if ranked else 0

    return agent


xray_agent = policy_agent("xray")
"""X-Ray: the valid mask with most of the distribution (paper section V)."""
