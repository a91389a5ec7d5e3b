import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    MultibodyPlant,
)
from pydrake.systems.framework import DiagramBuilder

from xray_drake.cell.bin import Bin, OpenBox, Tote
from xray_drake.resources import models_dir
from xray_drake.scene.plant import add_bin, add_tote
from xray_drake.trees import ConfigurationError

LENGTHS = st.floats(0.1, 1.0)
BINS = st.builds(
    Bin,
    length=LENGTHS,
    width=LENGTHS,
    wall_height=st.floats(0.02, 0.4),
    wall_thickness=st.floats(0.005, 0.05),
    wall_slope=st.floats(0, 40),
)


def holds(slabs: tuple, p_B: np.ndarray) -> bool:
    """Brute force: a point is in one of the slabs."""
    for slab in slabs:
        p_S = slab.X_BS[:3, :3].T @ (p_B - slab.X_BS[:3, 3])
        if (np.abs(p_S) < slab.size / 2 - 1e-7).all():
            return True
    return False


@given(BINS, st.tuples(*3 * [st.floats(-1, 1)]))
def test_inside_is_what_no_slab_holds(box: Bin, at: tuple) -> None:
    """Within the walls' height, to where the walls end outside."""
    lean = box.wall_height * np.tan(np.deg2rad(box.wall_slope))
    reach = box.half_size + lean + 0.9 * box.wall_thickness
    p_B = np.array([*(at[:2] * reach), abs(at[2]) * box.wall_height])
    room = float(box.distance_to_walls(p_B))
    if p_B[2] > 1e-6 and room > 1e-6:
        assert not holds(box.slabs(), p_B)
        assert box.is_over(p_B)
    # Beyond a wall by less than its thickness: in it.
    if 1e-6 < p_B[2] < 0.9 * box.wall_height and (
        -0.9 * box.wall_thickness < room < -1e-6
    ):
        assert holds(box.slabs(), p_B)
        assert not box.is_over(p_B)


@given(BINS, st.floats(0, 0.3))
def test_distance_is_across_the_wall(box: Bin, away: float) -> None:
    """From a point on the inside of a wall, along its normal."""
    slope = np.deg2rad(box.wall_slope)
    height = 0.5 * box.wall_height
    on_wall = [box.length / 2 + height * np.tan(slope), 0.0, height]
    p_B = on_wall + away * np.array([-np.cos(slope), 0, np.sin(slope)])
    others = box.width / 2 + np.tan(slope) * p_B[2]
    nearest = min(away, np.cos(slope) * others)
    across = np.cos(slope) * (2 * box.length / 2 + 2 * np.tan(slope) * p_B[2])
    nearest = min(nearest, across - away)
    assert box.distance_to_walls(p_B) == pytest.approx(nearest, abs=1e-9)


def geometries(plant: MultibodyPlant, inspector: object, name: str) -> list:
    """Returns role, name, shape, size, pose and properties of a body's."""
    body = plant.GetBodyByName(name)
    told = []
    for role, found in (
        ("seen", plant.GetVisualGeometriesForBody(body)),
        ("touched", plant.GetCollisionGeometriesForBody(body)),
    ):
        for geometry in found:
            shape = inspector.GetShape(geometry)
            X = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            proximity = inspector.GetProximityProperties(geometry)
            friction = proximity and (
                proximity.GetProperty("material", "coulomb_friction")
            )
            rigid = proximity and (
                proximity.HasProperty("hydroelastic", "compliance_type")
                and not proximity.HasProperty(
                    "hydroelastic", "hydroelastic_modulus"
                )
            )
            told.append(
                (
                    role,
                    inspector.GetName(geometry).split("::")[-1],
                    np.round(shape.size(), 6).tolist(),
                    np.round(X, 6).tolist(),
                    friction and friction.static_friction(),
                    rigid,
                )
            )
    return told


def test_models_are_the_nominal_cells() -> None:
    """What ``model_visualizer`` shows is what is simulated."""
    told = []
    for from_file in (False, True):
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
        if from_file:
            for name in ("bin", "tote"):
                path = models_dir() / name / f"{name}.sdf"
                Parser(plant).AddModels(str(path))
        else:
            add_bin(plant, Bin())
            add_tote(plant, Tote().beside(Bin()))
        plant.Finalize()
        inspector = scene_graph.model_inspector()
        told.append([geometries(plant, inspector, n) for n in ("bin", "tote")])
    assert told[0] == told[1]
    assert len(told[0][0]) == 16


@given(BINS, st.integers(0, 30))
def test_a_tote_stands_beside_the_bin_and_holds_its_slots(
    box: Bin, carried: int
) -> None:
    tote = Tote(length=0.3, width=0.42).beside(box)
    assert tote.position[0] - tote.outside[0] > box.outside[0] + 0.1
    p_W = np.array([*tote.slot(carried), 0.05])
    assert tote.holds(p_W) and tote.is_under(p_W) and not box.is_over(p_W)
    assert not tote.holds(p_W + [0, 0, 1]) and tote.is_under(p_W + [0, 0, 1])
    nine = {tuple(tote.slot(k).round(6)) for k in range(9)}
    assert len(nine) == 9
    np.testing.assert_array_equal(tote.slot(carried), tote.slot(carried + 9))


def test_a_tote_in_the_bin_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="stands in the bin"):
        Tote(position=[0.2, 0.1, 0.0]).beside(Bin())
    beside = Tote(position=[0.0, 0.7, 0.0]).beside(Bin())
    assert beside.holds(np.array([0.0, 0.7, 0.05]))


def test_what_left_is_not_in_it() -> None:
    box = OpenBox(wall_slope=20.0)
    assert box.is_over(np.array([0.27, 0, 0.1]))  # Over the leaning wall.
    assert not box.is_over(np.array([0.27, 0, 0.0]))
    assert box.is_over(np.array([0, 0, 3.0]))
    for p_B in ([0, 0, -0.02], [np.nan, 0, 0]):
        assert not box.is_over(np.array(p_B))
