"""Records a search as a film strip: a picture for each decision."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydrake.systems.framework import Context

from xray_drake.drawing.film_strip import Frame, film_strip_figure
from xray_drake.files import write_whole_file
from xray_drake.messages import SearchAction
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.record import ActionRecord

PICTURES = (".png", ".pdf", ".svg")
"""How the name of a film strip's file may end."""

_MARGIN = 16
"""Pixels that are shown around the objects."""


class FilmStrip:
    """An observer that keeps a frame of each decision.

    Attributes:
        frames: so far.
    """

    def __init__(self) -> None:
        """Begins without frames."""
        self.frames: list[Frame] = []
        self._objects = np.zeros((0, 0), bool)

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        """Keeps what is seen, inferred and decided."""
        name, grasp = diagram.scenario.camera.name, action.grasp

        def look(port: str) -> Any:
            return diagram.GetOutputPort(port).Eval(context)

        what = "nothing graspable"
        if grasp:
            what = "the target" if action.is_target else grasp.object
            what += f" by {grasp.kind.value}"
        rho = look("occupancy_inference.occupancy")
        instances = look("instance_segmenter.instances")
        seen = instances.labels >= 0
        self._objects = seen | self._objects if self.frames else seen
        chosen = np.zeros(rho.data.shape, bool)
        if grasp.object in instances.names:
            chosen = instances.mask(grasp.object)
        self.frames.append(
            Frame(
                color=np.array(look(f"{name}.color_image").data[:, :, :3]),
                occupancy=rho.supported(),
                chosen=chosen,
                title=f"{action.number}: {what}",
                note=f"support {action.support} px",
            )
        )

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        """Notes how the action ended."""
        outcome = ", ".join(filter(None, (record.outcome.value, record.reason)))
        last = self.frames[-1]
        self.frames[-1] = replace(last, note=f"{last.note}, {outcome}")

    def figure(self) -> Figure:
        """Draws the frames, cropped to where objects lay in any of them.

        Raises:
            ValueError: nothing has been decided.
        """
        rows, columns = _extent(self._objects), _extent(self._objects.T)
        return film_strip_figure(
            [
                replace(
                    frame,
                    color=frame.color[rows, columns],
                    occupancy=frame.occupancy[rows, columns],
                    chosen=frame.chosen[rows, columns],
                )
                for frame in self.frames
            ]
        )

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


def _extent(mask: np.ndarray) -> slice:
    """Returns the rows that an (H, W) bool mask is in, with a margin.

    All, if it is blank.
    """
    rows, _ = np.nonzero(mask)
    if not len(rows):
        return slice(None)
    return slice(max(int(rows.min()) - _MARGIN, 0), int(rows.max()) + _MARGIN)
