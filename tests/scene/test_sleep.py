from collections.abc import Iterable
from itertools import combinations

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    add_bin,
    add_objects,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.shapes import box
from xray_drake.scene.sleep import Sleeper

HALF = 0.02


def cube(name: str) -> ObjectModel:
    side = 2 * HALF
    return object_from_pieces(
        name, list(box(side, side, side).surfaces), density=500.0
    )


class Cubes:
    """Cubes of 4 cm in the bin, and the sleeper that minds them."""

    def __init__(self, **positions: tuple[float, float, float]) -> None:
        builder = DiagramBuilder()
        self.plant, self.scene_graph = add_plant(
            builder, default_plant_config()
        )
        add_bin(self.plant, with_tote=True)
        items = add_objects(self.plant, [cube(name) for name in positions])
        self.items = {item.name: item for item in items}
        for name, p_WO in positions.items():
            self.items[name].joint.SetDefaultPose(RigidTransform(list(p_WO)))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.root = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)
        self.sleeper = Sleeper(self.plant, self.scene_graph, items)

    def sleep(self, *names: str) -> None:
        self.sleeper.set_asleep(self.root, names)

    def advance(self, duration: float) -> None:
        self.simulator.AdvanceTo(self.root.get_time() + duration)

    def pose(self, name: str) -> np.ndarray:
        body = self.items[name].body
        return body.EvalPoseInWorld(self.context).GetAsMatrix4()

    def height(self, name: str) -> float:
        return float(self.pose(name)[2, 3])

    def locked(self) -> set[str]:
        return {
            name
            for name, item in self.items.items()
            if item.joint.is_locked(self.context)
        }

    def compared(self) -> set[tuple[str, str]]:
        """Names of the bodies whose contact is looked for."""
        query = self.scene_graph.get_query_output_port().Eval(
            self.scene_graph.GetMyContextFromRoot(self.root)
        )
        inspector = query.inspector()
        shapes = {
            name: self.plant.GetCollisionGeometriesForBody(
                self.plant.GetBodyByName(name)
            )
            for name in (*self.items, "bin", "tote")
        }
        return {
            (one, other)
            for one, other in combinations(shapes, 2)
            if not all(
                inspector.CollisionFiltered(a, b)
                for a in shapes[one]
                for b in shapes[other]
            )
        }


@pytest.fixture
def tower() -> Cubes:
    """Two cubes on each other, at rest, and one in the air above a corner."""
    cubes = Cubes(
        lower=(0.0, 0.0, HALF),
        upper=(0.0, 0.0, 3 * HALF),
        flying=(0.15, 0.1, 0.15),
    )
    cubes.sleep("flying")
    cubes.advance(0.3)
    cubes.sleep()
    return cubes


def test_sleepers_stay_exactly_where_they_are(tower: Cubes) -> None:
    before = tower.pose("lower"), tower.pose("upper")
    tower.sleep("lower", "upper")
    tower.advance(0.4)
    np.testing.assert_array_equal(tower.pose("lower"), before[0])
    np.testing.assert_array_equal(tower.pose("upper"), before[1])
    assert tower.height("flying") == pytest.approx(HALF, abs=5e-4)


def test_what_falls_on_a_sleeper_lies_on_it(tower: Cubes) -> None:
    above = RigidTransform([0.0, 0.0, 6 * HALF])
    tower.items["flying"].joint.SetPose(tower.context, above)
    tower.sleep("lower", "upper")
    before = tower.pose("upper")
    tower.advance(0.4)
    assert tower.height("flying") == pytest.approx(5 * HALF, abs=5e-4)
    np.testing.assert_array_equal(tower.pose("upper"), before)


def test_a_sleeper_hangs_in_the_air_until_it_wakes(tower: Cubes) -> None:
    tower.sleep("flying")
    tower.advance(0.2)
    assert tower.height("flying") == 0.15
    tower.sleep()
    tower.advance(0.1)
    assert tower.height("flying") == pytest.approx(
        0.15 - 0.5 * 9.81 * 0.1**2, abs=3e-3
    )


def test_falling_asleep_in_flight_stops_it(tower: Cubes) -> None:
    tower.advance(0.1)
    moving = tower.height("flying")
    joint = tower.items["flying"].joint
    assert joint.get_translational_velocity(tower.context)[2] < -0.5
    tower.sleep("flying")
    tower.advance(0.1)
    assert tower.height("flying") == moving
    assert not joint.get_translational_velocity(tower.context).any()
    assert not joint.get_angular_velocity(tower.context).any()
    tower.sleep()
    tower.advance(0.005)
    # It begins to fall anew, not with the speed that it had.
    assert joint.get_translational_velocity(tower.context)[2] > -0.1


@pytest.mark.parametrize(
    "still_asleep", [("lower",), ("upper",), ()], ids=["upper", "lower", "both"]
)
def test_contacts_come_back_with_the_one_that_wakes(
    tower: Cubes, still_asleep: Iterable[str]
) -> None:
    tower.sleep("lower", "upper")
    tower.advance(0.1)
    tower.sleep(*still_asleep)
    tower.advance(0.3)
    assert tower.height("lower") == pytest.approx(HALF, abs=5e-4)
    assert tower.height("upper") == pytest.approx(3 * HALF, abs=5e-4)


def test_what_rested_on_a_body_taken_away_falls_when_woken(
    tower: Cubes,
) -> None:
    tower.sleep("lower", "upper")
    tower.sleep("upper")
    aside = RigidTransform([-0.15, 0.0, HALF])
    tower.items["lower"].joint.SetPose(tower.context, aside)
    tower.advance(0.1)
    assert tower.height("upper") == pytest.approx(3 * HALF, abs=5e-4)
    tower.sleep()
    tower.advance(0.3)
    assert tower.height("upper") == pytest.approx(HALF, abs=5e-4)


def test_contacts_among_sleepers_are_not_even_looked_for(
    tower: Cubes,
) -> None:
    fixed = {"bin", "tote"}
    everything = combinations(("lower", "upper", "flying", *fixed), 2)
    pairs = {frozenset(pair) for pair in everything} - {frozenset(fixed)}
    for asleep in (
        {"lower", "upper"},
        {"lower", "upper", "flying"},
        {"upper"},
        set(),
        {"flying"},
    ):
        tower.sleep(*asleep)
        resting = asleep | fixed
        assert {frozenset(pair) for pair in tower.compared()} == {
            pair for pair in pairs if not pair <= resting
        }


def test_exactly_those_asked_for_sleep(tower: Cubes) -> None:
    assert tower.locked() == tower.sleeper.asleep(tower.root) == set()
    tower.sleep("lower", "upper")
    assert (
        tower.locked() == tower.sleeper.asleep(tower.root) == {"lower", "upper"}
    )
    tower.sleep("upper", "flying")
    assert (
        tower.locked()
        == tower.sleeper.asleep(tower.root)
        == {"upper", "flying"}
    )
    tower.sleep("flying", "upper")
    assert tower.locked() == {"upper", "flying"}
    tower.sleep()
    assert tower.locked() == tower.sleeper.asleep(tower.root) == set()


def test_in_another_context_nobody_sleeps_yet(tower: Cubes) -> None:
    """As after ``Simulator.reset_context``."""
    tower.sleep("flying")
    root = tower.diagram.CreateDefaultContext()
    context = tower.plant.GetMyContextFromRoot(root)
    tower.sleeper.set_asleep(root, {"flying"})
    assert tower.items["flying"].joint.is_locked(context)


def test_an_unknown_sleeper(tower: Cubes) -> None:
    with pytest.raises(KeyError, match="nobody"):
        tower.sleep("nobody")
    assert tower.sleeper.asleep(tower.root) == set()
