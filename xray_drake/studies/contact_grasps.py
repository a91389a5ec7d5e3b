"""Whether the analysis of grasps and the physics of contact agree.

Single objects lie on the bin's floor in their three likeliest resting poses.
Grasps of both kinds are drawn on each, some that the analysis says would hold
and some that it rejects by their wrench, and all are executed by contact: what
share of the former reaches the tote, and what share of the latter does not.
With loads, only grasps that hold are taken, and each is executed with the
object as heavy as these multiples of what the analysis says the contacts hold.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from scipy.spatial.transform import Rotation

from xray_drake.cell.bin import Bin
from xray_drake.cell.cell import Cell
from xray_drake.grasping.candidates import Failures
from xray_drake.grasping.evidence.model import ModelEvidence
from xray_drake.grasping.judgement import GRAVITY, JudgedGrasp
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    SearchAction,
)
from xray_drake.scene.heap import Heap
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.meshes.importer import import_meshes
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model
from xray_drake.search.execution import add_execution
from xray_drake.seeding import stream
from xray_drake.station.heap_station import build_heap_station
from xray_drake.station.scenario import Scenario
from xray_drake.studies.study import Line, Study, Table

TARGETS = ("box_1to1", "box_2to1", "box_5to1", "lid", "domino")
MESHES = (
    "a_lego_duplo",
    "a_cups",
    "b_toy_airplane",
    "d_toy_airplane",
    "b_colored_wood_blocks",
)
SEED = 10_000
LIBRARY = {"test": 10, "train": 5}
"""Objects of the library, by split."""

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


Trial = dict[str, Any]
"""One grasp, judged and executed:

- ``kind``: "jaw" or "suction";
- ``held``: the analysis says that it holds;
- ``judged``: its quality, or why it does not;
- ``load``: the object's weight over what the analysis says the contacts hold;
  None where they hold nothing;
- ``tilt``: angle of the approach to straight down, degrees;
- ``brought``: it reached the tote;
- ``outcome``, and ``reason`` of a failure, as the gripper felt them;
- ``turned``: angle by which the object, when it is in the air, is turned in the
  gripper against what was planned, degrees; None if it never was;
- ``simulated``: time of the action, s; ``seconds`` of processor time.
"""


def contact_grasps(
    meshes: Path | None,
    *,
    most: int | None = None,
    loads: Sequence[float] | None = None,
    carrier: str = "wrist",
) -> Study:
    """Returns the comparison of analysis and contact.

    Args:
        meshes: folder with the five folders of scans; None leaves them out.
        most: objects and poses, at most; the first ones.
        loads: weights over what the grasp holds; none takes the object's own.
        carrier: of the gripper, "wrist" or "arm".
    """
    loads = tuple(loads or ())
    items = [
        {"kind": kind, "name": name, "rest": rest}
        for kind, name in _shapes(meshes)
        for rest in range(RESTS)
    ]
    settings = {
        "meshes": str(meshes) if meshes else None,
        "loads": list(loads),
        "carrier": carrier,
    }
    return Study(
        "contact_grasps",
        items[:most],
        partial(_measure, meshes=meshes, loads=loads, carrier=carrier),
        contact_tables,
        seeds=[SEED],
        settings=settings,
    )


def _shapes(meshes: Path | None) -> Iterator[tuple[str, str]]:
    """Yields kind and name of each shape."""
    for split, count in LIBRARY.items():
        names = object_names(split=split)
        for name in stream(SEED, split).choice(names, count, replace=False):
            yield split, str(name)
    yield from (("target", name) for name in TARGETS)
    yield from (("mesh", name) for name in MESHES if meshes is not None)


def _measure(
    item: Line,
    *,
    meshes: Path | None,
    loads: Sequence[float],
    carrier: str,
) -> Line:
    """Draws and executes the grasps of one object in one pose."""
    model, rest = _make(item["kind"], item["name"], meshes), item["rest"]
    poses = _resting_poses(model)
    if rest >= len(poses):
        return {"trials": []}
    cell = GraspCell(model, poses[rest], carrier)
    X_WO = cell.settle(poses[rest])
    trials = []
    for grasp, judged in (
        _draw_grasps(model, X_WO, SEED + rest)
        if Bin().is_over(X_WO[:3, 3])
        else ()
    ):
        if not loads:
            trials.append(cell.try_out(grasp, judged, X_WO))
        elif judged.quality > 0.0:
            for load in loads:
                heavy = _weighing(model, load * judged.holding)
                evidence = ModelEvidence([heavy], seed=SEED + rest)
                again = GraspPlanner(evidence).judge(
                    grasp,
                    {model.name: X_WO},
                    X_WG_perturbed=grasp.X_WG,
                    friction=evidence.friction(model.name),
                )
                loaded = GraspCell(heavy, X_WO, carrier)
                trials.append(loaded.try_out(grasp, again, X_WO))
    return {"trials": trials}


def _make(kind: str, name: str, meshes: Path | None) -> ObjectModel:
    if kind == "target":
        return target_model(name)
    if kind == "mesh" and meshes is not None:
        (model,) = import_meshes(meshes / name).models
        return replace(model, name=name)
    return make_object(name)


def _weighing(model: ObjectModel, weight: float) -> ObjectModel:
    """Returns the same shape of another weight, N."""
    mass = weight / GRAVITY
    return replace(
        model, mass=mass, inertia=model.inertia * (mass / model.mass)
    )


def _resting_poses(model: ObjectModel) -> list[np.ndarray]:
    """Returns 4×4 X_WO in the likeliest stable poses, by quasi-statics."""
    rng = stream(SEED, model.name)
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


def _draw_grasps(
    model: ObjectModel, X_WO: np.ndarray, seed: int
) -> Iterator[tuple[Grasp, JudgedGrasp]]:
    """Yields grasps and what the analysis says of them.

    Of each kind one that holds, and one that is rejected by its wrench.
    """
    evidence = ModelEvidence([model], seed=seed)
    real, friction = GraspPlanner(evidence), evidence.friction(model.name)
    spec = evidence.gripper.spec
    strong = replace(
        spec,
        friction=LOOSE_FRICTION,
        vacuum_force=LOOSE_STRENGTH * spec.vacuum_force,
        cup_elasticity=LOOSE_STRENGTH * spec.cup_elasticity,
    )
    poses, X_OW = {model.name: X_WO}, np.linalg.inv(X_WO)
    loose = ModelEvidence([model], gripper=strong, seed=seed)
    both = loose.look(model.name, poses).all_candidates(Failures())
    for candidates in both:
        wanted = {True, False}
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
            if not (held or judged.is_too_weak) or held not in wanted:
                continue
            wanted.remove(held)
            stopped = replace(
                grasp,
                X_WG=judged.X_WG,
                X_OG=X_OW @ judged.X_WG,
                width=judged.width,
                quality=judged.quality,
            )
            yield stopped, judged
            if not wanted:
                break


class GraspCell:
    """The station with one object, and a gripper that is told what to do.

    Args:
        model: the object.
        X_WO: 4×4, where it lies.
        carrier: of the gripper, "wrist" or "arm".
    """

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
        station, self._parts = build_heap_station(scenario, heap)
        builder.AddSystem(station)
        self._controller, *_ = add_execution(
            builder,
            scenario,
            station,
            self._parts,
            heap,
            GraspPlanner(ModelEvidence([model])),
        )
        builder.ExportInput(self._controller.GetInputPort("action"), "action")
        self._diagram: Diagram = builder.Build()
        self._weight = GRAVITY * model.mass
        (self._item,) = self._parts.objects.values()

    def settle(self, X_WO: np.ndarray) -> np.ndarray:
        """Returns the 4×4 pose in which the object comes to rest."""
        simulator = self._lay(X_WO)
        simulator.AdvanceTo(SETTLE)
        return self._pose(simulator)

    def try_out(
        self, grasp: Grasp, judged: JudgedGrasp, X_WO: np.ndarray
    ) -> Trial:
        """Executes a grasp on the object that lies at a 4×4 pose."""
        start = time.process_time()
        simulator = self._lay(X_WO)
        self._order(simulator, SearchAction(number=1, grasp=grasp))
        context = self._controller.GetMyContextFromRoot(simulator.get_context())
        port = self._controller.GetOutputPort("status")
        now, turned = 0.0, None
        while now < LONGEST:
            now += 0.1
            simulator.AdvanceTo(now)
            X = self._pose(simulator)
            if turned is None and X[2, 3] > X_WO[2, 3] + IN_THE_AIR:
                turned = self._turn(simulator, grasp, X)
            status: GripperStatus = port.Eval(context)
            if status.number == 1 and status.mode is GripperMode.IDLE:
                break
        held = judged.quality > 0.0
        return {
            "kind": grasp.kind.value,
            "held": held,
            "judged": f"{judged.quality:.2f}" if held else judged.reason,
            "load": self._weight / judged.holding if judged.holding else None,
            "tilt": float(np.rad2deg(np.arccos(-grasp.X_WG[2, 2]))),
            "brought": bool(Cell().placed_tote.holds(X[:3, 3])),
            "outcome": status.outcome.value,
            "reason": status.reason,
            "turned": turned,
            "simulated": now,
            "seconds": time.process_time() - start,
        }

    def _lay(self, X_WO: np.ndarray) -> Simulator:
        simulator = Simulator(self._diagram)
        context = simulator.get_mutable_context()
        plant = self._parts.plant
        self._item.joint.SetPose(
            plant.GetMyMutableContextFromRoot(context), RigidTransform(X_WO)
        )
        self._order(simulator, SearchAction())
        return simulator

    def _order(self, simulator: Simulator, action: SearchAction) -> None:
        self._diagram.GetInputPort("action").FixValue(
            simulator.get_mutable_context(), AbstractValue.Make(action)
        )

    def _pose(self, simulator: Simulator) -> np.ndarray:
        context = self._parts.plant.GetMyContextFromRoot(
            simulator.get_context()
        )
        return self._item.body.EvalPoseInWorld(context).GetAsMatrix4()

    def _turn(
        self, simulator: Simulator, grasp: Grasp, X_WO: np.ndarray
    ) -> float:
        """Returns how far the object is turned in the gripper, degrees."""
        gripper = self._parts.gripper
        assert gripper is not None
        context = self._parts.plant.GetMyContextFromRoot(
            simulator.get_context()
        )
        X_WB = gripper.base.EvalPoseInWorld(context).GetAsMatrix4()
        jaw = grasp.kind is GraspKind.JAW
        X_BG = gripper.X_BJ if jaw else gripper.X_BC
        assert X_BG is not None
        X_WG = X_WB @ X_BG
        now = X_WG[:3, :3].T @ X_WO[:3, :3]
        turn = Rotation.from_matrix(grasp.X_OG[:3, :3] @ now)
        return float(np.rad2deg(turn.magnitude()))


def contact_tables(lines: list[Line]) -> Mapping[str, Table]:
    """Returns how far analysis and contact agree.

    The analysis asks whether the contacts hold the object as it lies; in
    contact it can also turn in the gripper until it hangs where they hold it.
    So what reaches the tote, and what reaches it as planned, are counted apart.
    """
    trials = [trial for line in lines for trial in line["trials"]]
    rows = []
    for held in (True, False):
        for kind in (GraspKind.JAW.value, GraspKind.SUCTION.value):
            some = [
                t for t in trials if t["held"] is held and t["kind"] == kind
            ]
            brought = [t["turned"] or 0.0 for t in some if t["brought"]]
            turns = [t["turned"] for t in some if t["turned"] is not None]
            rows.append(
                {
                    "analysis": "holds" if held else "does not",
                    "kind": kind,
                    "grasps": len(some),
                    "in the tote": len(brought),
                    f"and turned by less than {AS_PLANNED:.0f} deg": sum(
                        turn < AS_PLANNED for turn in brought
                    ),
                    "turned, median": np.median(turns) if turns else "",
                    "out of reach": sum(
                        t["reason"].startswith("out of the ") for t in some
                    ),
                }
            )
    return {"contact_grasps": rows}
