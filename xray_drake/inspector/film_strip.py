"""Records a search as a film strip: a picture for each decision."""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from xray_drake.drawing.colors import overlay
from xray_drake.drawing.figures import SEEN, Panel, panel_figure
from xray_drake.files import write_whole_file
from xray_drake.inspector.snapshot import Snapshot, SnapshotRecorder

_MOST_COLUMNS = 4
_MARGIN = 16
"""Pixels that are shown around the objects."""


class FilmStrip(SnapshotRecorder):
    """An observer that makes a picture of each decision."""

    def figure(self) -> Figure:
        """Draws the decisions in the order of reading.

        Each is the colour image with the distribution over it, dark violet to
        yellow, and the outline of what is grasped next (magenta), cropped to
        where objects lay in any of them.

        Raises:
            ValueError: nothing has been decided.
        """
        if not self.snapshots:
            raise ValueError("a film strip needs at least one frame")
        objects = np.logical_or.reduce(
            [shot.instances.labels >= 0 for shot in self.snapshots]
        )
        part = _extent(objects), _extent(objects.T)
        panels = [
            Panel(
                overlay(shot.color, shot.occupancy.supported())[part],
                "\n".join(_caption(shot)),
                {SEEN: shot.chosen[part]},
            )
            for shot in self.snapshots
        ]
        return panel_figure(panels, min(len(panels), _MOST_COLUMNS), width=3.0)

    def write(self, path: Path) -> None:
        """Writes the frames in the format that the file's name ends with.

        Raises:
            ValueError: nothing has been decided, or no format is called so.
            OSError: it cannot be written.
        """
        image = io.BytesIO()
        kind = path.suffix.lower().removeprefix(".")
        self.figure().savefig(image, format=kind)
        write_whole_file(path, image.getvalue())


def _caption(shot: Snapshot) -> tuple[str, str]:
    action, record = shot.action, shot.record
    what = "nothing graspable"
    if action.grasp:
        what = "the target" if action.is_target else action.grasp.object
        what += f" by {action.grasp.kind.value}"
    ended = (record.outcome.value, record.reason) if record else ()
    note = (f"support {action.support} px", *filter(None, ended))
    return f"{action.number}: {what}", ", ".join(note)


def _extent(mask: np.ndarray) -> slice:
    """Returns the rows that an (H, W) bool mask is in, with a margin.

    All, if it is blank.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return slice(None)
    return slice(max(int(rows[0]) - _MARGIN, 0), int(rows[-1]) + _MARGIN)
