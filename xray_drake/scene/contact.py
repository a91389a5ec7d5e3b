"""How objects feel each other: the contact material of plants and SDFormat."""

from dataclasses import dataclass

import numpy as np

from xray_drake.configuration import number
from xray_drake.geometry.convex import half_thickness
from xray_drake.scene.object_model import ObjectModel


@dataclass
class ContactConfig:
    """Material constants that the objects of a heap share.

    ``xray-drake study heap-settings`` compares settings by speed and quality;
    the reasons for the defaults stand with the fields.
    """

    # Pa/m. How fast pressure rises with depth in an object, the same in all.
    # Drake's compliant bodies have pressure E·depth/H, H being half a piece's
    # thickness. One modulus E for all makes thin pieces very stiff, and the
    # 5 mm target hops for ever. So E is chosen per piece as this times H. At
    # 2e7 objects sink 1.4 mm into each other on average; the stiffer, the more
    # light ones hop.
    pressure_gradient: float = number(5e7, "(0, 1e12]")
    # s/m, Hunt-Crossley. At 3 most heaps rest sooner, but light flat things hop
    # (a time step of 5 ms is long for them) and carry others along.
    dissipation: float = number(30.0, "(0, 1000]")
    # s. A free rotation decays over this time. It stands in for the rolling
    # resistance that rigid round bodies lack.
    tumble_time: float = number(0.05, "(0, 10]")


def hydroelastic_modulus(vertices: np.ndarray, config: ContactConfig) -> float:
    """Returns the modulus of a convex piece, Pa.

    Args:
        vertices: (n, 3) of the piece, m.
        config: gives the gradient of the pressure.
    """
    return config.pressure_gradient * half_thickness(vertices)


def angular_damping(model: ObjectModel, config: ContactConfig) -> float:
    """Returns the damping of an object's free rotation, N·m·s."""
    return float(np.trace(model.inertia) / 3 / config.tumble_time)
