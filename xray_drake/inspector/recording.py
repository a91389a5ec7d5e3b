"""Records a search as one HTML page that plays it."""

from pathlib import Path

from pydrake.geometry import Meshcat

from xray_drake.drawing.meshcat_layers import look_at_bin
from xray_drake.files import write_whole_file
from xray_drake.inspector.drawing import SearchDrawing
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.monitor import Observer
from xray_drake.search.record import SearchRecord
from xray_drake.search.rollout import run_search


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
