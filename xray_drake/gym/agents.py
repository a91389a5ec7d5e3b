"""Agents that need no training: X-Ray, and any mask."""

from collections.abc import Mapping

import numpy as np

from xray_drake.messages import (
    InstanceMasks,
    OccupancyDistribution,
    TargetMask,
)
from xray_drake.perception.ground_truth import target_instance
from xray_drake.policy.ranking import SearchView, order, xray

Observation = Mapping[str, np.ndarray]


def random_agent(observation: Observation, rng: np.random.Generator) -> int:
    """Chooses any of the valid masks; any mask at all where none is."""
    valid = np.flatnonzero(observation["action_mask"])
    return int(rng.choice(valid)) if len(valid) else 0


def xray_agent(
    observation: Observation,
    rng: np.random.Generator | None = None,
    *,
    target_first: bool = True,
) -> int:
    """X-Ray: the valid mask with most of the distribution (paper section V).

    On the same heap it does what the policy ``xray`` does, while a valid mask
    hides some of the target: where none does, the policy takes a weak grasp on
    what hides it, which is not among the valid ones.

    Args:
        observation: with ``occupancy`` and ``support``: make the environment
            with ``observe_occupancy=True``.
        rng: not used; so that agents can take each other's place.
        target_first: grasp the target whenever that is valid.

    Raises:
        KeyError: the observation has no ``occupancy`` or ``support``.
    """
    labels = np.asarray(observation["instances"])
    names = tuple(str(i) for i in range(labels.max(initial=-1) + 1))
    instances = InstanceMasks(labels, names)
    valid = tuple(str(i) for i in np.flatnonzero(observation["action_mask"]))
    rho = OccupancyDistribution(
        np.where(observation["support"], observation["occupancy"], 0)
    )
    target = target_instance(instances, TargetMask(observation["target_mask"]))
    view = SearchView(rho, instances, valid, target)
    ranked = order(
        view,
        xray,
        rng or np.random.default_rng(0),
        target=target if target_first else "",
    )
    return int(ranked[0].name) if ranked else 0
