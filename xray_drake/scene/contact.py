"""How objects feel each other: the contact material of plants and SDFormat."""

from dataclasses import dataclass

import numpy as np

from xray_drake.geometry.convex import half_thickness
from xray_drake.scene.object_model import ObjectModel


@dataclass
class ContactConfig:
    """Material constants that the objects of a heap share.

    ``tests/benchmarks/test_heap_speed.py`` compares settings by speed and
    quality; the reasons for the defaults stand with the fields.
    """

    # Pa/m. How fast pressure rises with depth in an object, the same in all.
    # Drake's compliant bodies have pressure E·depth/H, H being half a piece's
    # thickness. One modulus E for all makes thin pieces very stiff, and the
    # 5 mm target hops for ever. So E is chosen per piece as this times H. At
    # 2e7 objects sink 1.4 mm into each other on average; the stiffer, the more
    # light ones hop.
    pressure_gradient: float = 5e7
    # s/m, Hunt-Crossley, of heavy objects. At 30 a heap creeps for seconds
    # before it rests.
    dissipation: float = 3.0
    # s/m. But what lies flat and is light hops at 3 (a step of 5 ms is long for
    # it). So dissipation rises from that to this, inversely as the
    # square of mass per area,
    light_dissipation: float = 30.0
    # kg/m², and is reached here. (The target of 5 mm has 3.0.)
    light_areal_density: float = 3.5
    # s. A free rotation decays over this time. It stands in for the rolling
    # resistance that rigid round bodies lack.
    tumble_time: float = 0.05


def hydroelastic_modulus(vertices: np.ndarray, config: ContactConfig) -> float:
    """Returns the modulus of a convex piece, Pa.

    Args:
        vertices: (n, 3) of the piece, m.
        config: gives the gradient of the pressure.
    """
    return config.pressure_gradient * half_thickness(vertices)


def dissipation(model: ObjectModel, config: ContactConfig) -> float:
    """Returns an object's Hunt-Crossley dissipation, s/m.

    Args:
        model: its mass and its two longer sides decide.
        config: the range.
    """
    _, width, length = np.sort(model.extents)
    lightness = config.light_areal_density * width * length / model.mass
    return float(
        np.clip(
            config.light_dissipation * lightness**2,
            config.dissipation,
            config.light_dissipation,
        )
    )


def angular_damping(model: ObjectModel, config: ContactConfig) -> float:
    """Returns the damping of an object's free rotation, N·m·s."""
    return float(np.trace(model.inertia) / 3 / config.tumble_time)
