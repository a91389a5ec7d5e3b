"""Draws a search into Meshcat while it goes on, and records it as a page."""

from pathlib import Path

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context

from xray_drake.drawing.meshcat_layers import look_at_bin
from xray_drake.files import write_whole_file
from xray_drake.inspector.layers import SEARCH_LAYERS, SnapshotLayers
from xray_drake.inspector.snapshot import take_snapshot
from xray_drake.messages import SearchAction
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.monitor import Observer
from xray_drake.search.record import ActionRecord, SearchRecord
from xray_drake.search.rollout import run_search

_WAY_TO_HEAP = 2.0
"""Time from a decision until the gripper has come down to the heap by contact,
about, s."""


class SearchDrawing(Observer):
    """An observer that draws each decision over the heap.

    Those of the :class:`SnapshotLayers` that need no truth. They are seen,
    live until the action has ended, in a recording until the gripper has
    arrived: then the heap under them begins to move.
    """

    def __init__(self, meshcat: Meshcat, *, recording: bool = False) -> None:
        """Clears the layers of an earlier search.

        Args:
            meshcat: where to draw.
            recording: it is recording; otherwise it shows all at once.
        """
        self._layers = SnapshotLayers(meshcat, layers=SEARCH_LAYERS)
        self._recording = recording

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        """Draws a decision; hides the one before."""
        time = context.get_time()
        self._layers.add(take_snapshot(diagram, context, action))
        self._layers.show(action.number, time=time)
        if self._recording:
            motions = diagram.scenario.gripper
            by_contact = motions.execution == "contact"
            approach = motions.quasi_static.approach_time
            time += _WAY_TO_HEAP if by_contact else approach
            self._layers.show(0, time=time)

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        """Hides the layers of the action that has ended."""
        self._layers.show(0, time=context.get_time())


def record_search(
    diagram: SearchDiagram, *, observers: tuple[Observer, ...] = ()
) -> tuple[SearchRecord, Meshcat]:
    """Runs a search while Meshcat records it.

    Args:
        diagram: built with a Meshcat.
        observers: told of decisions and of ends of actions.

    Returns:
        The record, and the Meshcat that holds the recording.

    Raises:
        ValueError: the diagram was built without a Meshcat.
    """
    meshcat = diagram.meshcat
    if meshcat is None:
        raise ValueError(
            "the diagram has no Meshcat: build it with meshcat=start_meshcat()"
        )
    by_contact = diagram.scenario.gripper.execution == "contact"
    look_at_bin(meshcat, from_afar=by_contact)
    drawing = SearchDrawing(meshcat, recording=True)
    meshcat.StartRecording(
        frames_per_second=1 / diagram.scenario.visualization.publish_period,
        set_visualizations_while_recording=False,
    )
    try:
        record = run_search(diagram, observers=(drawing, *observers))
    finally:
        meshcat.StopRecording()
        meshcat.PublishRecording()
    return record, meshcat


def write_html(meshcat: Meshcat, path: Path) -> None:
    """Writes what a Meshcat shows, recording included, as one HTML page.

    Raises:
        OSError: the file cannot be written.
    """
    write_whole_file(path, meshcat.StaticHtml().encode())
