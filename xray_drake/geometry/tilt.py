"""How far a thing leans."""

import numpy as np


def tilt(X_WO: np.ndarray) -> float:
    """Returns the angle between a body's z axis and the vertical, rad.

    Either face may lie down.

    Args:
        X_WO: (4, 4) pose of the body.
    """
    return float(np.arccos(min(1.0, abs(X_WO[2, 2]))))
