"""The README's pictures: ``python -m xray_drake.inspector.pictures``."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from pydrake.systems.analysis import Simulator

from xray_drake.drawing.colors import overlay
from xray_drake.messages import SearchAction
from xray_drake.resources import models_dir
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.station.scenario import load_scenario


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
    return np.hstack([color, overlay(color, rho.data), chosen])


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


def main(folder: Path, seed: int) -> None:
    """Writes ``heap.png`` and ``diagram.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = load_scenario("demo")
    scenario.seed = seed
    diagram = build_search_diagram(scenario)
    picture = cv2.cvtColor(heap_picture(diagram), cv2.COLOR_RGB2BGR)
    cv2.imwrite(str(folder / "heap.png"), picture)
    diagram_picture(diagram, folder / "diagram.png")


if __name__ == "__main__":
    main(
        models_dir() / "pictures",
        int(sys.argv[1]) if len(sys.argv) > 1 else 10008,
    )
