"""The README's pictures: ``python -m xray_drake.inspector.pictures``."""

import argparse
import subprocess
from pathlib import Path

import cv2
import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    RenderCameraCore,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context
from pydrake.systems.sensors import CameraInfo

from xray_drake.drawing.colors import overlay
from xray_drake.inspector.film_strip import FilmStrip
from xray_drake.messages import GraspKind, GripperStatus, SearchAction
from xray_drake.resources import models_dir
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import attach_monitor
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import load_scenario

NAMES = ("heap", "diagram", "film", "contact")

_EYE = np.array([-0.12, -0.72, 0.72])
"""Where the camera stands that sees the gripper at work, m."""
_AIM = np.array([0.10, 0.02, 0.14])
"""What it looks at, m."""
_SLICE = 0.05
"""s between two looks at the gripper."""


def heap_picture(diagram: SearchDiagram) -> np.ndarray:
    """Renders a heap, the distribution over it, and what is grasped first.

    Args:
        diagram: a search that has not begun.

    Returns:
        (H, 3·W, 3) uint8 RGB: the colour image, the distribution laid over
        it, and the object chosen.
    """
    simulator = Simulator(diagram)
    simulator.Initialize()
    simulator.AdvanceTo(0.01)
    context = simulator.get_context()

    name = diagram.scenario.camera.name
    look = {
        port: diagram.GetOutputPort(port).Eval(context)
        for port in (
            f"{name}.color_image",
            "occupancy_inference.occupancy",
            "instance_segmenter.instances",
            "search_policy.action",
        )
    }
    color = look[f"{name}.color_image"].data[:, :, :3]
    rho = look["occupancy_inference.occupancy"]
    instances = look["instance_segmenter.instances"]
    action: SearchAction = look["search_policy.action"]
    chosen = np.array(color)
    if action.grasp.object in instances.names:
        mask = instances.mask(action.grasp.object).astype(np.uint8)
        outlines, _ = cv2.findContours(
            mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        cv2.drawContours(chosen, outlines, -1, (255, 220, 0), 3)
    return np.hstack([color, overlay(color, rho.supported()), chosen])


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
    forward = (_AIM - _EYE) / np.linalg.norm(_AIM - _EYE)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R_WC = RotationMatrix(
        np.column_stack([right, np.cross(forward, right), forward])
    )
    core = RenderCameraCore(
        diagram.scenario.camera.renderer_name,
        CameraInfo(840, 560, np.deg2rad(40.0)),
        ClippingRange(0.05, 5.0),
        RigidTransform(),
    )
    query = diagram.GetOutputPort("query_object").Eval(context)
    image = query.RenderColorImage(
        ColorRenderCamera(core),
        diagram.station.scene_graph.world_frame_id(),
        RigidTransform(R_WC, _EYE),
    )
    return np.array(image.data[:, :, :3])


def film_strip(diagram: SearchDiagram) -> FilmStrip:
    """Runs a search and returns its film strip."""
    film = FilmStrip()
    run_search(diagram, observers=(film,))
    return film


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
    diagram = build_search_diagram(scenario)
    if name == "diagram":
        diagram_picture(diagram, path)
    elif name == "film":
        film_strip(diagram).write(path)
    else:
        draw = heap_picture if name == "heap" else contact_picture
        cv2.imwrite(str(path), cv2.cvtColor(draw(diagram), cv2.COLOR_RGB2BGR))
    return path


_SEEDS = {"heap": 10008, "diagram": 10008, "film": 26, "contact": 0}
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
