"""The oracle: a ranking that knows where the target is."""

import numpy as np

from xray_drake.messages import OccupancyDistribution
from xray_drake.policy.ranking import Scores, SearchView, xray


def oracle(view: SearchView, rng: np.random.Generator) -> Scores:
    """Oracle: overlap with the target's true amodal mask (PROTOCOL.md).

    It is X-Ray given the truth as its distribution, ties included. It says how
    much a better inference could help X-Ray; it is no bound of what a policy
    can reach, since it neither knows what a removal will move nor which grasp
    will hold.

    Args:
        view: what is seen, and the truth.
        rng: see :func:`~xray_drake.policy.ranking.xray`.

    Returns:
        As of :func:`~xray_drake.policy.ranking.xray`.

    Raises:
        ValueError: the view does not say where the target is.
    """
    if view.true_mask is None:
        raise ValueError("the oracle needs the target's true mask")
    truth = OccupancyDistribution(view.true_mask, method="truth")
    return xray(
        SearchView(truth, view.instances, view.candidates, view.target), rng
    )
