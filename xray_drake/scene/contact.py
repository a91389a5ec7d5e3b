"""How objects feel each other: the contact material of plants and SDFormat."""

import numpy as np

from xray_drake.geometry.convex import half_thickness

PRESSURE_GRADIENT = 2e7
"""Pa/m. How fast pressure rises with depth in an object, the same in all.

Drake's compliant bodies have pressure E·depth/H, H being half a piece's
thickness. One modulus E for all makes thin pieces very stiff: the 5 mm target
then hops for ever (tilting 0.7 mm at every other step) and drives its
neighbours. So E is chosen per piece as this gradient times H."""

HUNT_CROSSLEY_DISSIPATION = 30.0
"""s/m. At 10, three of 16 heaps failed (the target flipped out of the bin, or
no rest), at 30 none."""


def hydroelastic_modulus(
    vertices: np.ndarray, gradient: float = PRESSURE_GRADIENT
) -> float:
    """Returns the modulus of a convex piece, Pa.

    Args:
        vertices: (n, 3) of the piece, m.
        gradient: of the pressure, Pa/m.
    """
    return gradient * half_thickness(vertices)
