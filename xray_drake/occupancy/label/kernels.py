"""The loops of the label, compiled.

Depths are compared as depths below the floor: "relative depth" is z-depth less
the floor's at the same pixel, negative above the floor. Moving a candidate and
offsetting its depths by the floor's leaves its relative depths as they are.

Numba keeps what it compiles beside this file, or in the user's cache where
that is read-only, so that only the first process pays.
"""

from typing import NamedTuple

import numpy as np

from xray_drake.kernels import kernel

UNREAD = np.float32(1e30)
"""Relative depth of a pixel without a reading: behind every target."""

OUTSIDE = np.float32(2e30)
"""The same of a pixel that shows no floor: no candidate may cover it."""

_TIE = 1e-6
"""Halves round up, and so does what is this close below, pixels."""


@kernel
def nearest(value: float) -> int:
    """Rounds to the nearest pixel."""
    return int(np.floor(value + 0.5 + _TIE))


@kernel
def relative_depths(
    scene: np.ndarray,
    ray: np.ndarray,
    center: np.ndarray,
    bounds: np.ndarray,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns what a target must be nearer than to be seen.

    Args:
        scene: (H, W) z-depth, m.
        ray: 3×3, from pixels (u, v, 1) to world rays of unit z-depth.
        center: (3,) the camera's, in the world, m; above the floor.
        bounds: (4,) x low, x high, y low, y high of the bin floor, m.
        tolerance: taken off the scene's depths, m.

    Returns:
        (H, W) float32 relative depth of the scene less the tolerance, m, or
        UNREAD or OUTSIDE; (H, W) float64 z-depth of the floor, m.
    """
    height, width = scene.shape
    relative = np.empty((height, width), dtype=np.float32)
    floor = np.empty((height, width))
    for v in range(height):
        for u in range(width):
            slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
            if slope >= 0:
                floor[v, u] = np.inf
                relative[v, u] = OUTSIDE
                continue
            depth = -center[2] / slope
            floor[v, u] = depth
            x = center[0] + depth * (ray[0, 0] * u + ray[0, 1] * v + ray[0, 2])
            y = center[1] + depth * (ray[1, 0] * u + ray[1, 1] * v + ray[1, 2])
            read = scene[v, u]
            if not (
                bounds[0] <= x <= bounds[1] and bounds[2] <= y <= bounds[3]
            ):
                relative[v, u] = OUTSIDE
            elif 0 < read < np.inf:
                relative[v, u] = read - depth - tolerance
            else:
                relative[v, u] = UNREAD
    return relative, floor


@kernel
def rotate_target(
    target: np.ndarray,
    floor: np.ndarray,
    pivot: np.ndarray,
    turns: np.ndarray,
    corner: np.ndarray,
    side: int,
) -> np.ndarray:
    """Turns the target's depth image about a point.

    Each pixel of the result looks up the nearest pixel it comes from, so that
    a turned mask has no holes.

    Args:
        target: (H, W) z-depth of the target alone, m; 0 or inf beside it.
        floor: (H, W) z-depth of the floor, m.
        pivot: (2,) u, v.
        turns: (k, 2) cosine and sine of each angle.
        corner: (2,) integer u, v of the rasters' first pixel.
        side: rows and columns of the rasters.

    Returns:
        (k, side, side) float32 relative depth of the target, m; NaN beside it.
    """
    height, width = target.shape
    rasters = np.full((len(turns), side, side), np.nan, dtype=np.float32)
    for k in range(len(turns)):
        cosine, sine = turns[k]
        for row in range(side):
            y = row + corner[1] - pivot[1]
            for column in range(side):
                x = column + corner[0] - pivot[0]
                u = nearest(pivot[0] + cosine * x + sine * y)
                v = nearest(pivot[1] - sine * x + cosine * y)
                if 0 <= u < width and 0 <= v < height:
                    depth = target[v, u]
                    if 0 < depth < np.inf:
                        rasters[k, row, column] = depth - floor[v, u]
    return rasters


@kernel
def find_runs(rasters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds the unbroken runs of pixels in each row of each raster.

    Args:
        rasters: (k, side, side), NaN beside the mask.

    Returns:
        (n, 3) int32: row, first column and one past the last of each run;
        (k + 1,) where those of each raster start.
    """
    count, side, _ = rasters.shape
    starts = np.zeros(count + 1, dtype=np.int64)
    for fill in range(2):
        found = 0
        runs = np.empty((starts[count], 3), dtype=np.int32)
        for k in range(count):
            for row in range(side):
                inside = False
                for column in range(side + 1):
                    covered = column < side and not np.isnan(
                        rasters[k, row, column]
                    )
                    if covered and not inside:
                        if fill:
                            runs[found, 0] = row
                            runs[found, 1] = column
                    elif inside and not covered:
                        if fill:
                            runs[found, 2] = column
                        found += 1
                    inside = covered
            starts[k + 1] = found
    return runs, starts


@kernel
def _add(change: np.ndarray, runs: np.ndarray, row: int, column: int) -> None:
    """Adds a mask to an image of differences along its rows."""
    for n in range(len(runs)):
        change[row + runs[n, 0], column + runs[n, 1]] += 1
        change[row + runs[n, 0], column + runs[n, 2]] -= 1


@kernel
def _any_nearer(depths: np.ndarray, others: np.ndarray) -> bool:
    """Says whether any of (n,) depths is less than its counterpart."""
    found = 0
    for n in range(len(depths)):  # without a branch: vectorised
        found |= depths[n] < others[n]
    return found > 0


class Candidates(NamedTuple):
    """The target in every orientation, and the shifts of each.

    Attributes:
        rasters: (k, side, side) float32 relative depths of the target, m; NaN
            beside it.
        runs: (n, 3) runs of the rasters.
        starts: (k + 1,) where those of each raster start.
        first: (k, 2) first shift in u and v, in steps, of each raster.
        last: (k, 2) last shift, included; all keep within the image.
        corner: (2,) u, v of the unshifted rasters' first pixel.
        step: pixels.
    """

    rasters: np.ndarray
    runs: np.ndarray
    starts: np.ndarray
    first: np.ndarray
    last: np.ndarray
    corner: np.ndarray
    step: int


@kernel
def count_hidden(
    relative: np.ndarray,
    candidates: Candidates,
    change: np.ndarray,
) -> np.ndarray:
    """Adds up the candidates of which nothing is seen.

    Args:
        relative: (H, W) float32 as ``relative_depths`` returns it, m.
        candidates: of the target.
        change: (H, W + 1) int32, changed in place: differences along the rows
            of the number of candidates that cover a pixel.

    Returns:
        (k,) number of candidates accepted. The unshifted one of the first
        raster is left out.
    """
    rasters, runs, starts, first, last, corner, step = candidates
    height, width = relative.shape
    accepted = np.zeros(len(rasters), dtype=np.int64)
    lowest = np.float32(np.inf)
    for value in rasters.flat:
        if value < lowest:
            lowest = value
    # The first column, from each one on, where any of the target may be seen.
    suspect = np.empty((height, width), dtype=np.int32)
    for v in range(height):
        column = width
        for u in range(width - 1, -1, -1):
            if relative[v, u] > lowest:
                column = u
            suspect[v, u] = column
    for k in range(len(rasters)):
        own = runs[starts[k] : starts[k + 1]]
        for i in range(first[k, 1], last[k, 1] + 1):
            top = corner[1] + i * step
            for j in range(first[k, 0], last[k, 0] + 1):
                left = corner[0] + j * step
                hidden = not (k == 0 and i == 0 and j == 0)
                for n in range(len(own)):
                    if not hidden:
                        break
                    row = own[n, 0]
                    end = own[n, 2]
                    start = suspect[top + row, left + own[n, 1]] - left
                    if start < end:
                        hidden = not _any_nearer(
                            rasters[k, row, start:end],
                            relative[top + row, left + start : left + end],
                        )
                if hidden:
                    accepted[k] += 1
                    _add(change, own, top, left)
    return accepted


@kernel
def count_seen(
    relative: np.ndarray,
    observed: np.ndarray,
    candidates: Candidates,
    accept_iou: float,
    change: np.ndarray,
) -> np.ndarray:
    """Adds up the candidates that would look as observed.

    Args:
        relative: (H, W) float32 as ``relative_depths`` returns it, m.
        observed: (H, W) bool modal mask, not blank.
        candidates: of the target.
        accept_iou: what the IoU with ``observed`` must be greater than.
        change: (H, W + 1) int32, changed in place as in ``count_hidden``.

    Returns:
        (k,) number of candidates accepted. The unshifted one of the first
        raster is left out.
    """
    rasters, runs, starts, first, last, corner, step = candidates
    height, width = relative.shape
    accepted = np.zeros(len(rasters), dtype=np.int64)
    running = np.zeros((height, width + 1), dtype=np.int32)
    for v in range(height):
        for u in range(width):
            running[v, u + 1] = running[v, u] + observed[v, u]
    size = running[:, width].sum()
    for k in range(len(rasters)):
        own = runs[starts[k] : starts[k + 1]]
        for i in range(first[k, 1], last[k, 1] + 1):
            top = corner[1] + i * step
            for j in range(first[k, 0], last[k, 0] + 1):
                left = corner[0] + j * step
                if k == 0 and i == 0 and j == 0:
                    continue
                # The union holds all of the observed mask, so the covered
                # share of that bounds the IoU.
                cover = 0
                for n in range(len(own)):
                    v = top + own[n, 0]
                    cover += (
                        running[v, left + own[n, 2]]
                        - running[v, left + own[n, 1]]
                    )
                if cover / size <= accept_iou:
                    continue
                common = 0
                shown = 0
                for n in range(len(own)):
                    row = own[n, 0]
                    for column in range(own[n, 1], own[n, 2]):
                        behind = relative[top + row, left + column]
                        if behind == OUTSIDE:
                            shown = -1
                            break
                        if behind > rasters[k, row, column]:
                            shown += 1
                            common += observed[top + row, left + column]
                    if shown < 0:
                        break
                if shown < 0:
                    continue
                if common / (size + shown - common) > accept_iou:
                    accepted[k] += 1
                    _add(change, own, top, left)
    return accepted
