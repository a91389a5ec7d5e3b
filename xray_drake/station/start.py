"""How a search starts: what is seen of the target, and what covers it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.scene.cameras import pinhole_camera
from xray_drake.scene.heap import Heap
from xray_drake.station.heap_station import build_heap_station
from xray_drake.station.scenario import Scenario

_COVERS = 0.01
"""Share of the target's silhouette that an object must lie over to count as
covering it: less can be a neighbour that only touches its edge."""


@dataclass(frozen=True)
class TargetView:
    """What the overhead camera sees of a target and of what lies over it.

    Attributes:
        target_pixels: of the target's amodal mask, at least 1.
        target_visible_fraction: share of them that show the target.
        cover_pixels: of the modal mask of the object that covers most of the
            target; 0 where nothing covers it.
        cover_fraction: share of the amodal mask that this object covers.
        num_covers: objects that cover a hundredth of the amodal mask or more.
    """

    target_pixels: int
    target_visible_fraction: float
    cover_pixels: int
    cover_fraction: float
    num_covers: int


def target_view(
    labels: np.ndarray,
    amodal: np.ndarray,
    label_of: Mapping[str, int],
    target: str,
) -> TargetView:
    """Looks at a target in a label image.

    Args:
        labels: (H, W) integer label image.
        amodal: (H, W) bool, the target's silhouette as if it lay alone.
        label_of: object to its value in ``labels``, the target among them.
        target: its name.
    """
    pixels = max(int(np.count_nonzero(amodal)), 1)
    seen = np.count_nonzero(labels == label_of[target])
    overlaps = {
        label: int(np.count_nonzero(amodal & (labels == label)))
        for name, label in label_of.items()
        if name != target
    }
    covers = {k: n for k, n in overlaps.items() if n >= _COVERS * pixels}
    overlap, first = max(((n, k) for k, n in covers.items()), default=(0, -1))
    return TargetView(
        target_pixels=pixels,
        target_visible_fraction=min(int(seen) / pixels, 1.0),
        cover_pixels=int(np.count_nonzero(labels == first)) if covers else 0,
        cover_fraction=overlap / pixels,
        num_covers=len(covers),
    )


def look_at_heap(scenario: Scenario, heap: Heap) -> TargetView:
    """Renders a heap at rest and looks at its target.

    Args:
        scenario: gives the camera.
        heap: what lies in the bin.
    """
    station, parts = build_heap_station(scenario, heap)
    context = station.CreateDefaultContext()
    if parts.gripper is None:
        # Wherever it is drawn, the camera does not see it.
        gripper = station.GetInputPort("gripper.position")
        gripper.FixValue(context, np.eye(1, gripper.size())[0])
    port = station.GetOutputPort(f"{scenario.camera.name}.label_image")
    target = heap.target
    amodal = project_mesh_mask(
        target.visual.vertices,
        target.visual.faces,
        heap.poses[target.name],
        pinhole_camera(scenario.camera),
    )
    labels = port.Eval(context).data[:, :, 0]
    return target_view(labels, amodal, parts.labels, target.name)
