import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.scene.contact import (
    ContactConfig,
    angular_damping,
    dissipation,
    hydroelastic_modulus,
)
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model

CONFIG = ContactConfig()

sides = st.floats(0.004, 0.12)
densities = st.floats(100.0, 3000.0)
examples = settings(deadline=None, max_examples=40)


def block(size: tuple[float, float, float], density: float) -> ObjectModel:
    return object_from_pieces(
        "block", list(box(*size).surfaces), density=density
    )


@examples
@given(st.tuples(sides, sides, sides), densities)
def test_dissipation_is_within_its_range(
    size: tuple[float, float, float], density: float
) -> None:
    value = dissipation(block(size, density), CONFIG)
    assert CONFIG.dissipation <= value <= CONFIG.light_dissipation


@examples
@given(st.tuples(sides, sides, sides), densities, st.floats(1.01, 5.0))
def test_what_is_lighter_dissipates_no_less(
    size: tuple[float, float, float], density: float, factor: float
) -> None:
    light = dissipation(block(size, density / factor), CONFIG)
    heavy = dissipation(block(size, density), CONFIG)
    assert light >= heavy
    within = CONFIG.dissipation < heavy and light < CONFIG.light_dissipation
    if within:  # inversely as the square of the mass per area
        assert light / heavy == pytest.approx(factor**2, rel=1e-6)


@examples
@given(st.tuples(sides, sides, sides), densities, st.permutations([0, 1, 2]))
def test_dissipation_does_not_depend_on_how_a_body_is_turned(
    size: tuple[float, float, float], density: float, order: list[int]
) -> None:
    turned = (size[order[0]], size[order[1]], size[order[2]])
    assert dissipation(block(turned, density), CONFIG) == pytest.approx(
        dissipation(block(size, density), CONFIG)
    )


@pytest.mark.parametrize(
    "size", [(0.05, 0.04, 0.01), (0.01, 0.03, 0.08), (0.04, 0.01, 0.02)]
)
def test_the_area_is_that_of_the_two_longer_sides(
    size: tuple[float, float, float],
) -> None:
    """A plate of 10 mm at 600 kg/m³ has 6 kg/m², however large it is."""
    expected = 30.0 * (3.5 / 6.0) ** 2
    assert dissipation(block(size, 600.0), CONFIG) == pytest.approx(expected)


def test_the_thin_target_is_light_and_a_brick_is_not() -> None:
    assert dissipation(target_model("box_2to1"), CONFIG) == 30.0
    assert dissipation(block((0.05, 0.05, 0.05), 600.0), CONFIG) == 3.0


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
