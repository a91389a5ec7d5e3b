"""The README's pictures: ``python -m xray_drake.inspector.pictures``."""

import argparse
import subprocess
from pathlib import Path

import cv2
import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context
from pydrake.systems.sensors import CameraConfig

from xray_drake.drawing.colors import overlay
from xray_drake.inspector.replay import first_decision
from xray_drake.inspector.snapshot import Snapshot
from xray_drake.messages import GraspKind, GripperStatus
from xray_drake.resources import models_dir
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import attach_monitor
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import load_scenario

NAMES = ("heap", "diagram", "contact")

_X_WC = RigidTransform(
    RollPitchYaw(np.deg2rad([-126.9, 0.0, -16.6])), [-0.12, -0.72, 0.72]
)
"""The camera sees the gripper at work."""
_SLICE = 0.05
"""s between two looks at the gripper."""


def heap_picture(shot: Snapshot) -> np.ndarray:
    """Draws a heap, the distribution over it, and what is grasped first.

    Args:
        shot: of the heap.

    Returns:
        (H, 3·W, 3) uint8 RGB: the colour image, the distribution laid over
        it, and the object chosen.
    """
    chosen = shot.color.copy()
    outlines, _ = cv2.findContours(
        shot.chosen.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(chosen, outlines, -1, (255, 220, 0), 3)
    likely = overlay(shot.color, shot.occupancy.supported())
    return np.hstack([shot.color, likely, chosen])


def diagram_picture(diagram: SearchDiagram, path: Path) -> None:
    """Draws the diagram's boxes and arrows as PNG.

    Raises:
        FileNotFoundError: graphviz is not installed.
        subprocess.CalledProcessError: graphviz failed.
    """
    subprocess.run(
        ["dot", "-Tpng", "-Gdpi=70", "-o", str(path)],
        input=diagram.GetGraphvizString(max_depth=1),
        text=True,
        check=True,
    )


def contact_picture(
    diagram: SearchDiagram,
    *,
    kind: GraspKind = GraspKind.SUCTION,
    height: float = 0.25,
) -> np.ndarray:
    """Renders the gripper with the first object that it lifts so.

    Args:
        diagram: a search by contact that has not begun.
        kind: of the grasp.
        height: of the object's frame over the floor when it is drawn, m.

    Returns:
        (560, 840, 3) uint8 RGB.

    Raises:
        ValueError: the diagram does not execute by contact, or the search
            ended without such a grasp.
    """
    if diagram.station.gripper is None:
        raise ValueError("the search is not executed by contact")
    simulator = Simulator(diagram)
    record = attach_monitor(simulator, diagram).record
    simulator.Initialize()
    context = simulator.get_context()
    status_port = diagram.GetOutputPort("gripper_controller.status")
    poses_port = diagram.GetOutputPort("cheat.body_poses")
    while not record.end:
        simulator.AdvanceTo(context.get_time() + _SLICE)
        status: GripperStatus = status_port.Eval(context)
        held = diagram.station.labels.get(status.held)
        if held is None or record.actions[-1].grasp.kind is not kind:
            continue
        if poses_port.Eval(context)[held].translation()[2] > height:
            return _render(diagram, context)
    raise ValueError(f"no object was lifted by {kind.value}: {record.end}")


def _render(diagram: SearchDiagram, context: Context) -> np.ndarray:
    """Returns (560, 840, 3) uint8 RGB of the bin, seen from the side."""
    camera, _ = CameraConfig(
        width=840,
        height=560,
        focal=CameraConfig.FovDegrees(y=40.0),
        renderer_name=diagram.scenario.camera.renderer_name,
    ).MakeCameras()
    world = diagram.station.scene_graph.world_frame_id()
    query = diagram.GetOutputPort("query_object").Eval(context)
    image = query.RenderColorImage(camera, world, _X_WC)
    return np.array(image.data[:, :, :3])


def write_picture(name: str, folder: Path, seed: int | None = None) -> Path:
    """Drops a heap and writes one picture of it.

    Args:
        name: one of ``NAMES``.
        folder: where ``name.png`` goes; made if it does not exist.
        seed: of the heap; by default the README's.

    Raises:
        ValueError: no picture is called so, or see :func:`contact_picture`.
        OSError: it cannot be written, or graphviz is not installed.
        subprocess.CalledProcessError: graphviz failed.
    """
    if name not in NAMES:
        raise ValueError(f"no picture is called {name!r}: {', '.join(NAMES)}")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.png"
    scenario = load_scenario("table3" if name == "contact" else "demo")
    scenario.seed = _SEEDS[name] if seed is None else seed
    if name == "contact":
        scenario.scene.num_objects = 14
    if name == "diagram":
        diagram_picture(build_search_diagram(scenario), path)
        return path
    if name == "heap":
        replay = first_decision(scenario, make_heap(scenario))
        picture = heap_picture(replay.snapshots[0])
    else:
        picture = contact_picture(build_search_diagram(scenario))
    cv2.imwrite(str(path), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return path


_SEEDS = {"heap": 10008, "diagram": 10008, "contact": 0}
"""Heaps that show what there is to see."""


def main() -> None:
    """Writes the pictures that the command line names, or all."""
    parser = argparse.ArgumentParser(description="Write the README's pictures.")
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--seed", type=int, help="of the heap")
    parser.add_argument(
        "--out", type=Path, default=models_dir() / "pictures", help="folder"
    )
    options = parser.parse_args()
    for name in options.names:
        print(write_picture(name, options.out, options.seed))


if __name__ == "__main__":
    main()
