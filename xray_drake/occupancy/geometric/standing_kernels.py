"""The loops over bodies that stand, compiled.

A body is drawn once for the middle of each *block* of pixels where it can be,
in true perspective, as a map of heights; within the block, it is moved by whole
pixels. Numba keeps what it compiles beside this file, or in the user's cache
where that is read-only, so that only the first process pays.
"""

from typing import NamedTuple

import cv2
import numpy as np

from xray_drake.kernels import kernel
from xray_drake.occupancy.geometric.standing_drawing import (
    Drawing,
    axis_at,
    box_spans,
    draw_in_block,
)

_OUT = -1
"""What stands for the count of a candidate that does not keep in place."""

TILE = 4
"""Cells of a silhouette are compared in tiles so large: where all that is
observed is higher, or lower, than all of the tile, that is one comparison."""

_STRIDE = 11
"""Tiles are compared so far apart that what is plainly seen ends it early."""


class PoseGrid(NamedTuple):
    """Blocks of pixels where a body's axis may be.

    Attributes:
        corners: (b, 2) first row and column of each block.
        side: of a block, pixels.
        step: between the candidates in it, pixels.
    """

    corners: np.ndarray
    side: int
    step: int


class Tiles(NamedTuple):
    """A silhouette's cells, tile by tile.

    Attributes:
        corners: (t, 2) first row and column of a tile, from the middle.
        cells: (t, 2) index of its first cell, number of its cells.
        bounds: (t, 2) least and greatest height of them, m.
        places: (n, 2) row and column of a cell, from the middle.
        heights: (n,) of it, m.
    """

    corners: np.ndarray
    cells: np.ndarray
    bounds: np.ndarray
    places: np.ndarray
    heights: np.ndarray


@kernel
def _runs(canvas: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Lists a silhouette's runs.

    Args:
        canvas: as from ``draw_body``.
        box: as from ``draw_body``.

    Returns:
        (n, 3) row, first column, one past the last, from the middle.
    """
    reach = canvas.shape[0] // 2
    count = 0
    rows, columns = box_spans(box, reach)
    most = (rows[1] - rows[0]) * (columns[1] - columns[0] + 1)
    runs = np.empty((max(most, 0), 3), dtype=np.int64)
    for row in range(rows[0], rows[1]):
        inside = False
        for column in range(columns[0], columns[1] + 1):
            covered = column < columns[1] and canvas[row, column] >= 0.0
            if covered and not inside:
                runs[count, 0] = row - reach
                runs[count, 1] = column - reach
            elif inside and not covered:
                runs[count, 2] = column - reach
                count += 1
            inside = covered
    return runs[:count]


@kernel
def _tiles(canvas: np.ndarray, box: np.ndarray) -> Tiles:
    """Sorts a silhouette's cells into tiles.

    Args:
        canvas: as from ``draw_body``.
        box: as from ``draw_body``.
    """
    reach = canvas.shape[0] // 2
    rows, columns = box_spans(box, reach)
    down = max(0, rows[1] - rows[0] + TILE - 1) // TILE
    across = max(0, columns[1] - columns[0] + TILE - 1) // TILE
    tiles, most = down * across, down * across * TILE * TILE
    corners = np.empty((tiles, 2), dtype=np.int64)
    cells = np.empty((tiles, 2), dtype=np.int64)
    bounds = np.empty((tiles, 2), dtype=np.float32)
    places = np.empty((most, 2), dtype=np.int64)
    heights = np.empty(most, dtype=np.float32)
    number, area = 0, 0
    for first in range(_STRIDE):
        for i in range(first, tiles, _STRIDE):
            top = rows[0] + (i // across) * TILE
            left = columns[0] + (i % across) * TILE
            start = area
            low, high = np.inf, -np.inf
            for row in range(top, min(top + TILE, rows[1])):
                for column in range(left, min(left + TILE, columns[1])):
                    value = canvas[row, column]
                    if value >= 0.0:
                        places[area, 0] = row - reach
                        places[area, 1] = column - reach
                        heights[area] = value
                        area += 1
                        low, high = min(low, value), max(high, value)
            if area > start:
                corners[number, 0], corners[number, 1] = (
                    top - reach,
                    left - reach,
                )
                cells[number, 0], cells[number, 1] = start, area - start
                bounds[number, 0], bounds[number, 1] = low, high
                number += 1
    return Tiles(
        corners[:number],
        cells[:number],
        bounds[:number],
        places[:area],
        heights[:area],
    )


def with_neighbours(observed: np.ndarray) -> np.ndarray:
    """Returns what ``_shows`` takes of an (H, W) float32 image of heights."""
    padded = np.pad(observed, TILE, constant_values=-np.inf)
    window = np.ones((TILE, TILE), dtype=np.uint8)
    return np.stack(
        [
            padded,
            cv2.erode(padded, window, anchor=(0, 0)),
            # OpenCV mirrors the window of a dilation.
            cv2.dilate(padded, window, anchor=(0, 0)),
        ]
    )


@kernel
def _shows(
    v: int,
    u: int,
    tiles: Tiles,
    observed: np.ndarray,
    most: int,
) -> int:
    """Counts the pixels a candidate would show; stops beyond ``most``.

    Args:
        v: row of its axis.
        u: column of it.
        tiles: as from ``_tiles``.
        observed: (3, H + 2·TILE, W + 2·TILE): heights of the observed surface
            with TILE more pixels on each side, m; the least and the greatest
            of the TILE² pixels right of and below each.
        most: pixels.
    """
    seen = 0
    for t in range(len(tiles.cells)):
        row = v + tiles.corners[t, 0] + TILE
        column = u + tiles.corners[t, 1] + TILE
        if observed[1, row, column] >= tiles.bounds[t, 1]:
            continue
        first, count = tiles.cells[t]
        if observed[2, row, column] < tiles.bounds[t, 0]:
            seen += count
        else:
            for i in range(first, first + count):
                row = v + tiles.places[i, 0] + TILE
                column = u + tiles.places[i, 1] + TILE
                if observed[0, row, column] < tiles.heights[i]:
                    seen += 1
        if seen > most:
            break
    return seen


@kernel
def _keeps(
    u: int,
    v: int,
    box: np.ndarray,
    shape: tuple[int, int],
    drawing: Drawing,
    room: np.ndarray,
) -> bool:
    """Says whether a candidate keeps within image and bin.

    Args:
        u: column of its axis.
        v: row of it.
        box: what ``draw_body`` returned.
        shape: height and width of the image.
        drawing: of the body.
        room: (4,) x low, x high, y low, y high of the axis, m.
    """
    if u + box[0] < -0.5 or u + box[1] > shape[1] - 0.5:
        return False
    if v + box[2] < -0.5 or v + box[3] > shape[0] - 0.5:
        return False
    x, y = axis_at(u, v, drawing)
    return room[0] <= x <= room[1] and room[2] <= y <= room[3]


@kernel
def count_hidden(
    observed: np.ndarray,
    candidates: PoseGrid,
    weights: np.ndarray,
    allowed: float,
    drawing: Drawing,
    room: np.ndarray,
    change: np.ndarray,
) -> None:
    """Adds the candidates of one orientation that would not be seen.

    Args:
        observed: as in ``_shows``.
        candidates: where the body may be.
        weights: (b,) what a candidate of each block counts.
        allowed: share of its silhouette that it may show.
        drawing: of the body.
        room: as in ``_keeps``.
        change: (H, W + 1) raised in place: along a row, the differences of
            the sum of the accepted silhouettes.
    """
    blocks, side, step = candidates
    shape = change.shape[0], change.shape[1] - 1
    for b in range(len(blocks)):
        canvas, box = draw_in_block(drawing, blocks[b], side)
        tiles = _tiles(canvas, box)
        area = len(tiles.heights)
        if area == 0:
            continue
        runs = _runs(canvas, box)
        most = int(allowed * area)
        for v in range(blocks[b, 0], blocks[b, 0] + side, step):
            for u in range(blocks[b, 1], blocks[b, 1] + side, step):
                if (
                    _keeps(u, v, box, shape, drawing, room)
                    and _shows(v, u, tiles, observed, most) <= most
                ):
                    _add(change, runs, v, u, weights[b])


@kernel
def _add(
    change: np.ndarray, runs: np.ndarray, v: int, u: int, weight: float
) -> None:
    height, width = change.shape[0], change.shape[1] - 1
    for i in range(len(runs)):
        row = v + runs[i, 0]
        if 0 <= row < height:
            change[row, min(max(u + runs[i, 1], 0), width)] += weight
            change[row, min(max(u + runs[i, 2], 0), width)] -= weight


@kernel
def count_common(
    running: np.ndarray,
    candidates: PoseGrid,
    drawing: Drawing,
    room: np.ndarray,
) -> np.ndarray:
    """Counts the pixels that candidates share with the observed mask.

    Args:
        running: (H, W + 1) int32, sums of the mask along each row.
        candidates: where the body may be.
        drawing: of the body.
        room: as in ``_keeps``.

    Returns:
        (b, n, n) int32: of each block's candidates, by row and column; −1 for
        those that do not keep in place.
    """
    blocks, side, step = candidates
    shape = running.shape[0], running.shape[1] - 1
    along = (side + step - 1) // step
    common = np.full((len(blocks), along, along), _OUT, dtype=np.int32)
    for b in range(len(blocks)):
        canvas, box = draw_in_block(drawing, blocks[b], side)
        runs = _runs(canvas, box)
        for i in range(along):
            v = blocks[b, 0] + i * step
            for k in range(along):
                u = blocks[b, 1] + k * step
                if not _keeps(u, v, box, shape, drawing, room):
                    continue
                total = 0
                for j in range(len(runs)):
                    row = v + runs[j, 0]
                    if 0 <= row < shape[0]:
                        first = min(max(u + runs[j, 1], 0), shape[1])
                        last = min(max(u + runs[j, 2], 0), shape[1])
                        total += running[row, last] - running[row, first]
                common[b, i, k] = total
    return common


@kernel
def count_shown(
    observed: np.ndarray,
    common: np.ndarray,
    least: float,
    candidates: PoseGrid,
    limits: np.ndarray,
    best: np.ndarray,
    drawing: Drawing,
) -> np.ndarray:
    """Counts the pixels that candidates would show.

    Counting ends early where a candidate is out: it cannot reach the share of
    the best IoU found so far, if that is trusted; or, if coverage decides, it
    shows too much more than the one that shows least. What is counted is then
    the whole silhouette.

    Args:
        observed: as in ``_shows``, and −inf in the observed mask, where the
            target shows.
        common: as from ``count_common``.
        least: candidates that share fewer pixels are left out.
        candidates: where the body may be.
        limits: (5,) pixels of the mask; share of the best IoU that is asked
            for; least IoU that is trusted; pixels that may be shown beyond
            the mask more than by the one that shows least; 1 where coverage
            alone decides, else 0.
        best: (2,) best IoU and fewest pixels shown beyond the mask so far;
            changed in place.
        drawing: of the body.

    Returns:
        (b, n, n) int32, −1 for those left out.
    """
    blocks, side, step = candidates
    shown = np.full(common.shape, _OUT, dtype=np.int32)
    size, share, trusted, spread = limits[0], limits[1], limits[2], limits[3]
    by_coverage = limits[4] > 0.0
    for b in range(len(blocks)):
        if common[b].max() < least:
            continue
        canvas, box = draw_in_block(drawing, blocks[b], side)
        tiles = _tiles(canvas, box)
        area = len(tiles.heights)
        for i in range(common.shape[1]):
            v = blocks[b, 0] + i * step
            for k in range(common.shape[2]):
                together = common[b, i, k]
                if together < least or together <= 0:
                    continue
                u = blocks[b, 1] + k * step
                most = area
                if by_coverage:
                    if best[1] < np.inf:
                        most = min(most, int(best[1] + spread) + 1 + together)
                elif best[0] >= trusted:
                    # together / (seen + size − together) ≥ share · best
                    bound = together / (share * best[0]) - size + together
                    most = min(most, int(bound) + 1)
                seen = _shows(v, u, tiles, observed, most)
                shown[b, i, k] = area if seen > most else seen
                if seen <= most:
                    iou = together / (seen + size - together)
                    best[0] = max(best[0], iou)
                    best[1] = min(best[1], seen - together)
    return shown


@kernel
def add_accepted(
    accepted: np.ndarray,
    weights: np.ndarray,
    candidates: PoseGrid,
    drawing: Drawing,
    change: np.ndarray,
) -> None:
    """Adds the silhouettes of accepted candidates.

    Args:
        accepted: (b, n, n) bool: of each block's candidates.
        weights: (b,) what a candidate counts.
        candidates: where the body may be.
        drawing: of the body.
        change: as in ``count_hidden``.
    """
    blocks, side, step = candidates
    for b in range(len(blocks)):
        if not accepted[b].any():
            continue
        canvas, box = draw_in_block(drawing, blocks[b], side)
        runs = _runs(canvas, box)
        for i in range(accepted.shape[1]):
            for k in range(accepted.shape[2]):
                if accepted[b, i, k]:
                    v = blocks[b, 0] + i * step
                    u = blocks[b, 1] + k * step
                    _add(change, runs, v, u, weights[b])
