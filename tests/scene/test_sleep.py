from collections.abc import Iterable
from itertools import combinations

import numpy as np
import pytest
from pydrake.geometry import Box, ProximityProperties
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.scene.placed import HALF, Cubes, cube
from xray_drake.scene.plant import add_object, add_plant, default_plant_config
from xray_drake.scene.sleep import Sleeper


class Sleepers(Cubes):
    """Cubes and the sleeper that minds them."""

    def __init__(self, **positions: tuple[float, float, float]) -> None:
        super().__init__(**positions)
        self.sleeper = Sleeper(
            self.plant, self.scene_graph, self.items.values()
        )

    def sleep(self, *names: str) -> None:
        self.sleeper.set_asleep(self.root, names)


@pytest.fixture
def tower() -> Sleepers:
    """Two cubes on each other, at rest, and one in the air above a corner."""
    cubes = Sleepers(
        lower=(0.0, 0.0, HALF),
        upper=(0.0, 0.0, 3 * HALF),
        flying=(0.15, 0.1, 0.15),
    )
    cubes.sleep("flying")
    cubes.advance(0.3)
    cubes.sleep()
    return cubes


def test_sleepers_stay_exactly_where_they_are(tower: Sleepers) -> None:
    """And what falls on one lies on it."""
    tower.put("flying", 0.0, 0.0, 6 * HALF)
    tower.sleep("lower", "upper")
    before = tower.pose("lower"), tower.pose("upper")
    tower.advance(0.4)
    np.testing.assert_array_equal(tower.pose("lower"), before[0])
    np.testing.assert_array_equal(tower.pose("upper"), before[1])
    assert tower.height("flying") == pytest.approx(5 * HALF, abs=5e-4)


def test_a_sleeper_hangs_in_the_air_until_it_wakes(tower: Sleepers) -> None:
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
    tower.advance(0.1)
    # It begins to fall anew, not with the speed that it had.
    fallen = moving - tower.height("flying")
    assert fallen == pytest.approx(0.5 * 9.81 * 0.1**2, abs=3e-3)


@pytest.mark.parametrize(
    "still_asleep", [("lower",), ("upper",), ()], ids=["upper", "lower", "both"]
)
def test_contacts_come_back_with_the_one_that_wakes(
    tower: Sleepers, still_asleep: Iterable[str]
) -> None:
    tower.sleep("lower", "upper")
    tower.advance(0.1)
    tower.sleep(*still_asleep)
    tower.advance(0.3)
    assert tower.height("lower") == pytest.approx(HALF, abs=5e-4)
    assert tower.height("upper") == pytest.approx(3 * HALF, abs=5e-4)


def test_exactly_those_asked_for_sleep_and_their_contacts_are_not_sought(
    tower: Sleepers,
) -> None:
    fixed = {"bin", "tote"}
    pairs = set(map(frozenset, combinations([*tower.items, *fixed], 2)))
    for names in ("lower upper", "lower upper flying", "upper", "", "flying"):
        asleep = set(names.split())
        for _ in range(2):
            tower.sleep(*asleep)
            assert tower.locked() == tower.sleeper.asleep(tower.root) == asleep
        resting = asleep | fixed
        compared = {pair for pair in pairs if not pair <= resting}
        assert tower.compared() == compared


def test_a_clone_of_a_context_wakes_as_the_original_does(
    tower: Sleepers,
) -> None:
    """As when a policy looks ahead."""
    tower.sleep("lower", "upper")
    clone = Simulator(tower.diagram, tower.root.Clone())
    tower.sleep()
    tower.advance(0.1)
    root = clone.get_mutable_context()
    assert tower.sleeper.asleep(root) == {"lower", "upper"}
    tower.sleeper.set_asleep(root, set())
    clone.AdvanceTo(root.get_time() + 0.3)
    tower.context = tower.plant.GetMyContextFromRoot(root)
    assert tower.height("lower") == pytest.approx(HALF, abs=5e-4)
    assert tower.height("upper") == pytest.approx(3 * HALF, abs=5e-4)


def test_a_second_sleeper_wakes_what_the_first_put_to_sleep(
    tower: Sleepers,
) -> None:
    """As when a notebook's cell is executed twice."""
    tower.sleep("lower", "upper")
    items = tower.items.values()
    tower.sleeper = Sleeper(tower.plant, tower.scene_graph, items)
    tower.sleep()
    tower.advance(0.3)
    assert tower.height("upper") == pytest.approx(3 * HALF, abs=5e-4)


@pytest.mark.parametrize("on", ["table", "world"])
def test_all_that_is_welded_to_the_world_counts_as_fixed(on: str) -> None:
    """Geometry of the world body is refused: Drake up to 1.51 would crash."""
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, default_plant_config())
    table = plant.world_body()
    if on == "table":
        table = plant.AddRigidBody("table")
        plant.WeldFrames(plant.world_frame(), table.body_frame())
    X_TG, shape = RigidTransform([0.0, 0.0, -HALF]), Box(1.0, 1.0, 2 * HALF)
    top = plant.RegisterCollisionGeometry(
        table, X_TG, shape, "top", ProximityProperties()
    )
    item = add_object(plant, cube("cube"))
    plant.Finalize()
    if on == "world":
        with pytest.raises(ValueError, match="welded to the world"):
            Sleeper(plant, scene_graph, [item])
        return
    root = builder.Build().CreateDefaultContext()
    Sleeper(plant, scene_graph, [item]).set_asleep(root, {"cube"})
    query = scene_graph.get_query_output_port().Eval(
        scene_graph.GetMyContextFromRoot(root)
    )
    (piece,) = plant.GetCollisionGeometriesForBody(item.body)
    assert query.inspector().CollisionFiltered(piece, top)
