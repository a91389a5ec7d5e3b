"""Draws a search into Meshcat while it goes on."""

from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context

from xray_drake.drawing.meshcat_layers import (
    draw_grasp,
    draw_occupancy,
    draw_outline,
)
from xray_drake.messages import InstanceMasks, SearchAction
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.record import ActionRecord

ROOT = "/search"

_WAY_TO_HEAP = 2.0
"""Time from a decision until the gripper has come down to the heap by contact,
about, s."""


class SearchDrawing:
    """An observer that draws each decision over the heap.

    Layers of step k are at ``/search/step_k``: ``occupancy``, ``outline`` of
    the object chosen, ``grasp``. The layers of the last decision are seen,
    live until the action has ended, in a recording until the gripper has
    arrived: then the heap under them begins to move. Each step has paths of
    its own, since Meshcat animates visibility but not geometry.
    """

    def __init__(self, meshcat: Meshcat, *, recording: bool = False) -> None:
        """Clears the layers of an earlier search.

        Args:
            meshcat: where to draw.
            recording: it is recording; otherwise it shows all at once.
        """
        self._meshcat = meshcat
        self._recording = recording
        self._step = ""
        meshcat.Delete(ROOT)

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        """Draws a decision; hides the one before."""
        name = diagram.scenario.camera.name

        def look(port: str) -> Any:
            return diagram.GetOutputPort(port).Eval(context)

        depth = look(f"{name}.depth_image").data[:, :, 0]
        camera = look(f"{name}.camera")
        instances: InstanceMasks = look("instance_segmenter.instances")
        rho = look("occupancy_inference.occupancy")
        time = context.get_time()
        self._hide(time)
        self._step = f"{ROOT}/step_{action.number:02d}"
        values = rho.supported()
        draw_occupancy(
            self._meshcat, f"{self._step}/occupancy", values, depth, camera
        )
        if action.grasp.object in instances.names:
            mask = instances.mask(action.grasp.object)
            draw_outline(
                self._meshcat, f"{self._step}/outline", mask, depth, camera
            )
        draw_grasp(self._meshcat, f"{self._step}/grasp", action.grasp)
        self._meshcat.SetProperty(
            self._step, "visible", False, time_in_recording=0.0
        )
        self._meshcat.SetProperty(
            self._step, "visible", True, time_in_recording=time
        )
        if self._recording:
            motions = diagram.scenario.gripper
            by_contact = motions.execution == "contact"
            self._hide(
                time + _WAY_TO_HEAP
                if by_contact
                else time + motions.quasi_static.approach_time
            )

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        """Hides the layers of the action that has ended."""
        self._hide(context.get_time())

    def _hide(self, time: float) -> None:
        if self._step:
            self._meshcat.SetProperty(
                self._step, "visible", False, time_in_recording=time
            )
            self._step = ""
