"""The chance that a planned grasp holds."""

import numpy as np

from xray_drake.messages import Grasp

_QUALITIES = (0.2, 0.7)
_SHARES = (0.5, 0.94)
"""Of the grasps that the planner gave a lower quality than the first, half held
in execution; of those better than the second, 94 %."""

USUAL = 0.82
"""Share of all planned grasps that held in heaps."""


def chance(grasp: Grasp) -> float:
    """Returns the probability that a grasp lifts its object.

    It is interpolated between what was counted of weak and of good grasps; 0
    where there is no grasp.
    """
    if not grasp:
        return 0.0
    return float(np.interp(grasp.quality, _QUALITIES, _SHARES))
