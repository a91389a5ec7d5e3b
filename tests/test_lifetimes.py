"""Systems, heaps, searches and episodes leave nothing behind."""

import ast
import gc
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    Context,
    Diagram,
    System,
)

from xray_drake.gym.environment import MechanicalSearchEnv
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import SearchAction
from xray_drake.scene import drop as drop_module
from xray_drake.scene.drop import drop_heap
from xray_drake.scene.heap import (
    Heap,
)
from xray_drake.scene.library import make_object
from xray_drake.scene.targets import target_model
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import attach_monitor
from xray_drake.search.rollout import run_search
from xray_drake.search.transitions import Transitions
from xray_drake.station.scenario import Scenario

PACKAGE = Path(__file__).parents[1] / "xray_drake"
DRAKE = version("drake")
STATM = Path("/proc/self/statm")

freed_by_drake = pytest.mark.skipif(
    tuple(map(int, DRAKE.split(".")[:2])) < (1, 58),
    reason=f"Drake {DRAKE} frees no system written in Python; 1.58 does, with "
    "Python 3.12 or 3.13",
)

Watched = dict[str, weakref.ref]


def watch(**things: Any) -> Watched:
    return {name: weakref.ref(thing) for name, thing in things.items()}


def left(watched: Watched) -> list[str]:
    """Returns what is still there."""
    gc.collect()
    return [name for name, reference in watched.items() if reference()]


# What no port may do.


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """The modules of the package, by their paths."""
    return {
        str(path.relative_to(PACKAGE)): ast.parse(
            path.read_text(encoding="utf-8")
        )
        for path in PACKAGE.rglob("*.py")
    }


def test_ports_are_declared_in_one_way(trees: dict[str, ast.Module]) -> None:
    """What keeps its system is used by the base class alone.

    So does a lambda of a port that refers to its system.
    """
    for name, tree in trees.items():
        if name == "lifetimes.py":
            continue
        nodes = list(ast.walk(tree))
        used = {n.name for n in nodes if isinstance(n, ast.alias)}
        used |= {n.attr for n in nodes if isinstance(n, ast.Attribute)}
        assert not used & {"LeafSystem", "VectorSystem", "ValueProducer"}, name
        declared = [
            argument
            for call in nodes
            if isinstance(call, ast.Call)
            and getattr(call.func, "attr", "").startswith("Declare")
            for argument in (*call.args, *(k.value for k in call.keywords))
            if isinstance(argument, ast.Lambda)
        ]
        for node in (n for argument in declared for n in ast.walk(argument)):
            assert not isinstance(node, ast.Name) or node.id != "self", name


# The systems of the package, in searches that have them all.


class Idle(CollectableLeafSystem):
    """A system of one's own; it may keep plant, objects, planner."""

    def __init__(self, parts: Any) -> None:
        super().__init__()
        self.parts = parts
        self.DeclareAbstractOutputPort(
            "action", lambda: Value(SearchAction()), self._calc
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        output.set_value(SearchAction())


def by_truth(scenario: Scenario) -> dict[str, Any]:
    scenario.policy.name = "oracle"
    return {}


def by_images(scenario: Scenario) -> dict[str, Any]:
    scenario.policy.name = "combined"
    scenario.perception.detector = "hsv"
    scenario.perception.segmenter = "depth"
    scenario.perception.noise = True
    scenario.gripper.grasps = "depth"
    return {}


def by_contact(scenario: Scenario) -> dict[str, Any]:
    scenario.gripper.execution = "contact"
    return {"meshcat": Meshcat(MeshcatParams(host="localhost"))}


def by_agent(scenario: Scenario) -> dict[str, Any]:
    return {"agent": True}


def by_ones_own(scenario: Scenario) -> dict[str, Any]:
    return {"replace": {"search_policy": Idle}}


SEARCHES: Mapping[Callable[[Scenario], dict[str, Any]], set[str]] = {
    by_truth: {
        "GroundTruthInstanceSegmenter",
        "GroundTruthTargetDetector",
        "OccupancyInference",
        "QuasiStaticGripper",
        "SearchDiagram",
        "SearchPolicy",
        "TrueTargetMask",
    },
    by_images: {
        "DepthInstanceSegmenter",
        "GraspedBody",
        "HsvTargetDetector",
        "NoisyDepthSensor",
        "SearchMemory",
    },
    by_contact: {"GripperController", "RestSensor", "SealLight", "SuctionCup"},
    by_agent: {"ChoicePolicy"},
    by_ones_own: {"Idle"},
}


def parts_of(diagram: Diagram) -> Iterator[System]:
    yield diagram
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            yield from parts_of(system)
        else:
            yield system


def run(diagram: SearchDiagram) -> Watched:
    """Runs a search for a moment and looks at all of its outputs."""
    simulator = Simulator(diagram)
    monitor = attach_monitor(simulator, diagram)
    simulator.AdvanceTo(0.06)
    context = simulator.get_context()
    for index in range(diagram.num_output_ports()):
        diagram.get_output_port(index).Eval(context)
    parts = {type(part).__name__: part for part in parts_of(diagram)}
    return watch(**parts, monitor=monitor, context=context)


@freed_by_drake
@pytest.mark.parametrize("change", SEARCHES, ids=lambda change: change.__name__)
def test_every_system_is_freed(
    change: Callable[[Scenario], dict[str, Any]],
    tiny_heap: Heap,
    tiny_scenario: Scenario,
) -> None:
    given = change(tiny_scenario)
    watched = run(build_search_diagram(tiny_scenario, heap=tiny_heap, **given))
    assert watched.keys() >= SEARCHES[change] | {"MultibodyPlant", "SceneGraph"}
    assert left(watched) == []


def test_no_system_is_left_out(trees: dict[str, ast.Module]) -> None:
    bases = {
        node.name: {ast.unparse(b).split("[")[0] for b in node.bases}
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    abstract = {
        "Diagram",
        "CollectableLeafSystem",
        "TransferSystem",
        "_Perception",
    }
    systems, found = abstract, set[str]()
    while systems != found:
        found = systems
        systems = found | {n for n, b in bases.items() if b & found}
    assert (systems - abstract) | {"Idle"} == set.union(*SEARCHES.values())


class Watcher:
    """Watches a search from inside, without keeping it."""

    def __init__(self) -> None:
        self.watched: Watched = {}

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        self.watched |= watch(diagram=diagram, context=context)

    def ended(self, *_: object) -> None:
        pass


@freed_by_drake
def test_a_search_is_freed(tiny_heap: Heap, tiny_scenario: Scenario) -> None:
    watcher, transitions = Watcher(), Transitions()
    tiny_scenario.horizon = 1
    for _ in range(2):  # the second recalls the first
        record = run_search(
            build_search_diagram(tiny_scenario, heap=tiny_heap),
            observers=(watcher,),
            transitions=transitions,
        )
        assert record.num_actions == 1
        assert left(watcher.watched) == []


@freed_by_drake
def test_a_heap_is_freed(monkeypatch: pytest.MonkeyPatch) -> None:
    watched: Watched = {}
    add_plant = drop_module.add_plant

    def noted(*args: Any, **kwargs: Any) -> Any:
        plant, scene_graph = add_plant(*args, **kwargs)
        watched.update(watch(plant=plant, scene_graph=scene_graph))
        return plant, scene_graph

    monkeypatch.setattr(drop_module, "add_plant", noted)
    drop_heap(target_model("box_2to1"), [make_object("carton_000")], seed=1)
    assert watched.keys() == {"plant", "scene_graph"}
    assert left(watched) == []


# The environment.


@pytest.fixture
def small_heap(tiny_heap: Heap) -> Heap:
    """The target under the book, and nothing else."""
    book = tiny_heap.objects[0]
    names = (tiny_heap.target.name, book.name)
    poses = {name: tiny_heap.poses[name] for name in names}
    return replace(tiny_heap, objects=(book,), poses=poses)


@pytest.fixture
def small_scenario(tiny_scenario: Scenario) -> Scenario:
    """One action, planned and carried out in a hurry, seen in few pixels."""
    camera = tiny_scenario.camera
    camera.width, camera.height = 128, 96
    camera.center_x, camera.center_y = 63.5, 47.5
    camera.focal.x = camera.focal.y = 138.0
    tiny_scenario.horizon = 1
    tiny_scenario.plant_config.time_step = 0.01
    tiny_scenario.policy.min_visible_pixels = 10
    planner = tiny_scenario.gripper.planner
    planner.jaw_samples, planner.suction_samples, planner.rehearsals = 40, 20, 0
    motion = tiny_scenario.gripper.quasi_static
    motion.speed, motion.approach_time, motion.rest_round = 3.0, 0.05, 0.05
    return tiny_scenario


def resident() -> float:
    """Returns the memory that the process holds, MB, where Linux tells it."""
    if not STATM.exists():
        return 0.0
    return int(STATM.read_text().split()[1]) * 4096 / 1e6


@freed_by_drake
def test_an_episode_is_freed_before_the_next(
    small_heap: Heap, small_scenario: Scenario
) -> None:
    """So thirty of them add little memory."""
    watched: Watched = {}

    def drop(scenario: Scenario) -> Heap:
        assert left(watched) == []
        return small_heap

    env = MechanicalSearchEnv(
        small_scenario, drop=drop, render_mode="rgb_array"
    )
    before = 0.0
    gc.freeze()  # or the collector would look at all of torch each time
    for seed in range(35):
        if seed == 5:
            before = resident()
        observation, _ = env.reset(seed=seed)
        action = int(np.argmax(observation["action_mask"]))
        *_, terminated, truncated, info = env.step(action)
        assert info["valid"]
        assert terminated or truncated
        if seed < 5:
            env.render()
        watched = watch(
            diagram=env.simulator.get_system(),
            context=env.simulator.get_context(),
            monitor=env.monitor,
        )
    assert len(left(watched)) == 3
    assert resident() - before < 30
    env.close()
    assert left(watched) == []
    gc.unfreeze()
