import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.scene.contact import (
    ContactConfig,
    angular_damping,
    hydroelastic_modulus,
)
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.shapes import box

CONFIG = ContactConfig()

sides = st.floats(0.004, 0.12)
densities = st.floats(100.0, 3000.0)
examples = settings(deadline=None, max_examples=40)


def block(size: tuple[float, float, float], density: float) -> ObjectModel:
    return object_from_pieces(
        "block", list(box(*size).surfaces), density=density
    )


@examples
@given(sides, sides, sides, st.floats(1e6, 1e9))
def test_pressure_rises_with_depth_at_one_rate_in_all(
    x: float, y: float, z: float, gradient: float
) -> None:
    (piece,) = block((x, y, z), 500.0).pieces
    config = ContactConfig(pressure_gradient=gradient)
    modulus = hydroelastic_modulus(piece, config)
    # Drake's compliant hull has the pressure E · depth / half thickness.
    assert modulus / (min(x, y, z) / 2) == pytest.approx(gradient, rel=1e-6)


def test_a_free_rotation_decays_over_the_time_given() -> None:
    model = block((0.03, 0.04, 0.05), 500.0)
    mean = np.linalg.eigvalsh(model.inertia).mean()
    for time in (0.03, 0.1):
        config = ContactConfig(tumble_time=time)
        assert angular_damping(model, config) == pytest.approx(mean / time)
