"""Lets the analysis of grasps and the physics of contact check each other.

    python tests/benchmarks/contact_grasps.py out.jsonl --meshes FOLDER

lays single objects on the bin's floor in their three likeliest resting poses,
draws grasps of both kinds on each, some that the analysis says would hold and
some that it rejects by their wrench, and executes all by contact. Each object
and pose is one line of the file; what is in the file is not done again. Prints
what share of the former reaches the tote, what share of the latter does not,
and where both disagree. With ``--carrier arm`` the arm carries the gripper;
what is beyond its reach is counted apart.

    python tests/benchmarks/contact_grasps.py loads.jsonl --load 0.5 --load 2

takes only grasps that hold and executes each with the object as heavy as these
multiples of what the analysis says the contacts hold.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import trimesh
import typer
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from rich.console import Console
from scipy.spatial.transform import Rotation

from xray_drake.cli.options import Mix
from xray_drake.grasping.candidates import (
    GraspCandidates,
    jaw_candidates,
    suction_candidates,
)
from xray_drake.grasping.judgement import GRAVITY, GraspJudge, JudgedGrasp
from xray_drake.grasping.planner import ModelGraspPlanner
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    SearchAction,
)
from xray_drake.provenance import Run, current, made_by, open_lines
from xray_drake.scene.heap import Heap
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.meshes.importer import import_meshes
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import inside_bin, inside_tote
from xray_drake.scene.targets import target_model
from xray_drake.search.execution import add_execution
from xray_drake.seeding import stream
from xray_drake.station.heap_station import build_heap_station
from xray_drake.station.scenario import Scenario

TARGETS = ("box_1to1", "box_2to1", "box_5to1", "lid", "domino")
MESHES = (
    "a_lego_duplo",
    "a_cups",
    "b_toy_airplane",
    "d_toy_airplane",
    "b_colored_wood_blocks",
)
TEST_SHAPES = 10
TRAIN_SHAPES = 5
RESTS = 3
"""Resting poses of an object."""

SETTLE = 1.0
"""s for an object to come to rest where it was laid."""

IN_THE_AIR = 0.08
"""m over where it lay."""

LONGEST = 60.0
"""s of simulated time that no action takes."""

CHECKS = 400
"""Candidates that are judged, at most, to find what is wanted."""

AS_PLANNED = 10.0
"""An object that turns by less in the gripper is held as planned, degrees."""

LOOSE_FRICTION = 2.0
"""Pairs are sampled as if friction were this, so that some cannot hold."""

LOOSE_STRENGTH = 100.0
"""And cups as if they were this many times as strong."""


@dataclass(frozen=True)
class Trial:
    """One grasp, judged and executed.

    Attributes:
        kind: "jaw" or "suction".
        held: the analysis says that it holds.
        judged: its quality, or why it does not.
        load: the object's weight over what the analysis says the contacts hold;
            None where they hold nothing.
        tilt: angle of the approach to straight down, degrees.
        brought: it reached the tote.
        outcome: as the gripper felt it.
        reason: of a failure, as the gripper felt it.
        turned: angle by which the object, when it is in the air, is turned in
            the gripper against what was planned, degrees; None if it never was.
        simulated: time of the action, s.
        seconds: of processor time.
    """

    kind: str
    held: bool
    judged: str
    load: float | None
    tilt: float
    brought: bool
    outcome: str
    reason: str
    turned: float | None
    simulated: float
    seconds: float


class Cell:
    """The station with one object, and the gripper that is told what to do."""

    def __init__(
        self, model: ObjectModel, X_WO: np.ndarray, carrier: str
    ) -> None:
        scenario = Scenario()
        scenario.gripper.carrier = carrier
        scenario.gripper.execution = "contact"
        heap = Heap(
            target=model,
            objects=(),
            poses={model.name: X_WO},
            seed=0,
            num_dropped=0,
            attempts=1,
            settle_time=0.0,
        )
        builder = DiagramBuilder()
        station, self.parts = build_heap_station(scenario, heap)
        builder.AddSystem(station)
        execution = add_execution(
            builder,
            scenario,
            station,
            self.parts,
            heap,
            ModelGraspPlanner([model]),
        )
        self.controller = execution.controller
        builder.ExportInput(self.controller.GetInputPort("action"), "action")
        self.diagram: Diagram = builder.Build()
        (self.item,) = self.parts.objects.values()

    def lay(self, X_WO: np.ndarray) -> Simulator:
        """Returns a simulation that begins with the object there."""
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        plant = self.parts.plant
        self.item.joint.SetPose(
            plant.GetMyMutableContextFromRoot(context), RigidTransform(X_WO)
        )
        self._order(simulator, SearchAction())
        return simulator

    def settle(self, X_WO: np.ndarray) -> np.ndarray:
        """Returns where the object comes to rest."""
        simulator = self.lay(X_WO)
        simulator.AdvanceTo(SETTLE)
        return self._pose(simulator)

    def execute(
        self, grasp: Grasp, X_WO: np.ndarray
    ) -> tuple[GripperStatus, bool, float | None, float]:
        """Returns how it ended, in the tote or not, turn, and simulated s."""
        simulator = self.lay(X_WO)
        self._order(simulator, SearchAction(number=1, grasp=grasp))
        context = self.controller.GetMyContextFromRoot(simulator.get_context())
        time, turned = 0.0, None
        while time < LONGEST:
            time += 0.1
            simulator.AdvanceTo(time)
            X = self._pose(simulator)
            if turned is None and X[2, 3] > X_WO[2, 3] + IN_THE_AIR:
                turned = self._turn(simulator, grasp, X)
            status: GripperStatus = self.controller.GetOutputPort(
                "status"
            ).Eval(context)
            if status.number == 1 and status.mode is GripperMode.IDLE:
                break
        return status, inside_tote(X[:3, 3]), turned, time

    def _turn(
        self, simulator: Simulator, grasp: Grasp, X_WO: np.ndarray
    ) -> float:
        gripper = self.parts.gripper
        assert gripper is not None
        context = self.parts.plant.GetMyContextFromRoot(simulator.get_context())
        X_WB = gripper.base.EvalPoseInWorld(context).GetAsMatrix4()
        jaw = grasp.kind is GraspKind.JAW
        X_WG = X_WB @ (gripper.X_BJ if jaw else gripper.X_BC)
        now = X_WG[:3, :3].T @ X_WO[:3, :3]
        turn = Rotation.from_matrix(grasp.X_OG[:3, :3] @ now)
        return float(np.rad2deg(turn.magnitude()))

    def _order(self, simulator: Simulator, action: SearchAction) -> None:
        self.diagram.GetInputPort("action").FixValue(
            simulator.get_mutable_context(), AbstractValue.Make(action)
        )

    def _pose(self, simulator: Simulator) -> np.ndarray:
        context = self.parts.plant.GetMyContextFromRoot(simulator.get_context())
        return self.item.body.EvalPoseInWorld(context).GetAsMatrix4()


def shapes(seed: int, meshes: Path | None) -> Iterator[tuple[str, str]]:
    """Yields kind and name of each fixed shape."""
    for split, count in (("test", TEST_SHAPES), ("train", TRAIN_SHAPES)):
        names = object_names(split=split)
        for name in stream(seed, split).choice(names, count, replace=False):
            yield split, str(name)
    for name in TARGETS:
        yield "target", name
    if meshes is not None:
        for name in MESHES:
            yield "mesh", name


def make(kind: str, name: str, meshes: Path | None) -> ObjectModel:
    """Returns a shape."""
    if kind == "target":
        return target_model(name)
    if kind == "mesh" and meshes is not None:
        (model,) = import_meshes(meshes / name).models
        return replace(model, name=name)
    return make_object(name)


def resting_poses(model: ObjectModel, seed: int) -> list[np.ndarray]:
    """Returns 4×4 X_WO in the likeliest stable poses, by quasi-statics."""
    rng = stream(seed, model.name)
    rests, _ = trimesh.poses.compute_stable_poses(
        model.visual.convex_hull, center_mass=model.p_OCom, threshold=0.0
    )
    poses = []
    for X_rest in rests[:RESTS]:
        X = trimesh.transformations.rotation_matrix(
            rng.uniform(0, 2 * np.pi), [0, 0, 1]
        )
        X[:2, 3] = rng.uniform(-0.1, 0.1, 2)
        X_WO = X @ X_rest
        X_WO[2, 3] -= (model.visual.vertices @ X_WO[2, :3] + X_WO[2, 3]).min()
        poses.append(X_WO)
    return poses


def draw_grasps(
    model: ObjectModel, X_WO: np.ndarray, seed: int, number: int
) -> Iterator[tuple[Grasp, JudgedGrasp]]:
    """Yields grasps and what the analysis says of them.

    Of each kind as many as wanted that hold, and as many rejected by wrench.
    """
    real = ModelGraspPlanner([model], seed=seed)
    strong = replace(
        real.parameters,
        friction=LOOSE_FRICTION,
        vacuum_force=LOOSE_STRENGTH * real.parameters.vacuum_force,
        cup_elasticity=LOOSE_STRENGTH * real.parameters.cup_elasticity,
    )
    loose = ModelGraspPlanner([model], parameters=strong, seed=seed)
    config, friction = real.config, real.friction(model.name)
    pairs, points = loose.samples(model.name)
    both: Sequence[GraspCandidates] = (
        jaw_candidates(
            model,
            pairs,
            X_WO,
            GraspJudge([model]),
            friction=loose.friction(model.name),
            max_tilt=config.max_tilt,
            insertion=config.insertion,
        ),
        suction_candidates(
            model,
            points,
            X_WO,
            parameters=strong,
            friction=loose.friction(model.name),
            max_tilt=config.max_tilt,
            seal_tolerance=config.judgement.seal_tolerance,
            turns=config.suction_turns,
        ),
    )
    poses, X_OW = {model.name: X_WO}, np.linalg.inv(X_WO)
    for candidates in both:
        wanted = {True: number, False: number}
        rng = stream(seed, f"{candidates.kind.value} of {model.name}")
        for i in rng.permutation(len(candidates))[:CHECKS]:
            grasp = Grasp(
                kind=candidates.kind,
                object=model.name,
                X_WG=candidates.X_WG[i],
                X_OG=X_OW @ candidates.X_WG[i],
                width=float(candidates.width[i]),
            )
            judged = real.judge(
                grasp, poses, X_WG_perturbed=grasp.X_WG, friction=friction
            )
            held = judged.quality > 0.0
            by_wrench = judged.reason.startswith("holds ")
            if not (held or by_wrench) or not wanted[held]:
                continue
            wanted[held] -= 1
            yield (
                replace(
                    grasp,
                    X_WG=judged.X_WG,
                    X_OG=X_OW @ judged.X_WG,
                    width=judged.width,
                    quality=judged.quality,
                ),
                judged,
            )
            if not any(wanted.values()):
                break


def weighing(model: ObjectModel, weight: float) -> ObjectModel:
    """Returns the same shape of another weight, N."""
    mass = weight / GRAVITY
    return replace(
        model, mass=mass, inertia=model.inertia * (mass / model.mass)
    )


def try_out(
    model: ObjectModel, X_WO: np.ndarray, seed: int, number: int, carrier: str
) -> list[Trial]:
    """Executes the grasps of one object in one pose."""
    cell = Cell(model, X_WO, carrier)
    X_WO = cell.settle(X_WO)
    if not inside_bin(X_WO[:3, 3]):
        return []
    return [
        execute(cell, model, grasp, judged, X_WO)
        for grasp, judged in draw_grasps(model, X_WO, seed, number)
    ]


def load_up(
    model: ObjectModel,
    X_WO: np.ndarray,
    seed: int,
    number: int,
    carrier: str,
    loads: Sequence[float],
) -> list[Trial]:
    """Executes grasps that hold with the object of several weights."""
    X_WO = Cell(model, X_WO, carrier).settle(X_WO)
    if not inside_bin(X_WO[:3, 3]):
        return []
    poses, trials = {model.name: X_WO}, []
    for grasp, light in draw_grasps(model, X_WO, seed, number):
        if light.quality == 0.0:
            continue
        for load in loads:
            heavy = weighing(model, load * light.holding)
            real = ModelGraspPlanner([heavy], seed=seed)
            judged = real.judge(
                grasp,
                poses,
                X_WG_perturbed=grasp.X_WG,
                friction=real.friction(model.name),
            )
            cell = Cell(heavy, X_WO, carrier)
            trials.append(execute(cell, heavy, grasp, judged, X_WO))
    return trials


def execute(
    cell: Cell,
    model: ObjectModel,
    grasp: Grasp,
    judged: JudgedGrasp,
    X_WO: np.ndarray,
) -> Trial:
    """Executes one grasp."""
    held, weight = judged.quality > 0.0, GRAVITY * model.mass
    start = time.process_time()
    status, brought, turned, simulated = cell.execute(grasp, X_WO)
    return Trial(
        kind=grasp.kind.value,
        held=held,
        judged=f"{judged.quality:.2f}" if held else judged.reason,
        load=weight / judged.holding if judged.holding else None,
        tilt=float(np.rad2deg(np.arccos(-grasp.X_WG[2, 2]))),
        brought=brought,
        outcome=status.outcome.value,
        reason=status.reason,
        turned=turned,
        simulated=simulated,
        seconds=time.process_time() - start,
    )


def table(lines: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yields rows of Markdown: how far analysis and contact agree.

    The analysis asks whether the contacts hold the object as it lies; in
    contact it can also turn in the gripper until it hangs where they hold it.
    So what reaches the tote, and what reaches it as planned, are counted apart.
    """
    yield (
        "| analysis | kind | grasps | in the tote | and turned by less than "
        f"{AS_PLANNED:.0f}° | turned, median | out of reach |"
    )
    yield "|---|---|---|---|---|---|---|"
    for held in (True, False):
        for kind in (GraspKind.JAW.value, GraspKind.SUCTION.value, ""):
            some = [
                t
                for line in lines
                for t in line["trials"]
                if t["held"] is held and kind in ("", t["kind"])
            ]
            turns = [t["turned"] for t in some if t["turned"] is not None]
            brought = [t for t in some if t["brought"]]
            counts = [
                len(brought),
                sum((t["turned"] or 0.0) < AS_PLANNED for t in brought),
            ]
            shares = [
                f"{count} ({count / len(some):.0%})" if some else "–"
                for count in counts
            ]
            turned = f"{np.median(turns):.1f}°" if turns else "–"
            yield (
                f"| {'holds' if held else 'does not'} | {kind or 'both'} | "
                f"{len(some)} | {shares[0]} | {shares[1]} | {turned} | "
                f"{sum(t['reason'].startswith('out of the ') for t in some)} |"
            )


def disagreements(lines: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yields a line for each grasp that analysis and contact see otherwise."""
    for line in lines:
        for t in line["trials"]:
            if t["held"] is not t["brought"]:
                yield (
                    f"{line['name']} pose {line['rest']} {t['kind']} at "
                    f"{t['tilt']:.0f}°: analysis {t['judged']}; contact "
                    f"{t['outcome']} {t['reason']}"
                )


def main(
    out: Annotated[Path, typer.Argument(help="JSON lines; taken up again.")],
    meshes: Annotated[Path | None, typer.Option(file_okay=False)] = None,
    seed: Annotated[int, typer.Option(min=0)] = 10_000,
    number: Annotated[int, typer.Option(min=1, help="Of each sort.")] = 1,
    most: Annotated[int, typer.Option(min=0, help="Items to add.")] = 1000,
    load: Annotated[
        list[float] | None,
        typer.Option(help="Weights over what the grasp holds; repeatable."),
    ] = None,
    carrier: Annotated[str, typer.Option(help="wrist or arm.")] = "wrist",
    mix: Mix = False,
) -> None:
    """Executes grasps that the analysis accepts and rejects, by contact."""
    settings = {
        "meshes": str(meshes) if meshes else None,
        "seed": seed,
        "number": number,
        "load": load,
        "carrier": carrier,
    }
    run = Run(
        "contact_grasps",
        current(scripts=[Path(__file__)]),
        seeds=[seed],
        settings=settings,
    )
    with open_lines(out, run, mix=mix) as (lines, add):
        measure(lines, add, meshes, seed, number, most, load, carrier)
    Console(width=200).print(made_by(out), soft_wrap=True, highlight=False)


def measure(
    lines: list[dict[str, Any]],
    add: Callable[[dict[str, Any]], None],
    meshes: Path | None,
    seed: int,
    number: int,
    most: int,
    load: list[float] | None,
    carrier: str,
) -> None:
    """Executes what is missing of the lines, and prints the tables."""
    console = Console(width=200)
    done = {(line["name"], line["rest"]) for line in lines}
    added = 0
    for kind, name in shapes(seed, meshes):
        wanted = [r for r in range(RESTS) if (name, r) not in done]
        if not wanted or added >= most:
            continue
        model = make(kind, name, meshes)
        poses = resting_poses(model, seed)
        for rest in wanted[: most - added]:
            if rest >= len(poses):
                continue
            begin = model, poses[rest], seed + rest, number, carrier
            trials = load_up(*begin, load) if load else try_out(*begin)
            line = {
                "kind": kind,
                "name": name,
                "rest": rest,
                "trials": [asdict(trial) for trial in trials],
            }
            add(line)
            lines.append(line)
            added += 1
            console.print(
                f"{name} pose {rest}: "
                + ", ".join(
                    f"{t.kind} {'+' if t.held else '-'} "
                    f"{'in tote' if t.brought else t.reason or t.outcome}"
                    for t in trials
                ),
                highlight=False,
            )
    for row in (*table(lines), "", *disagreements(lines)):
        console.print(row, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
