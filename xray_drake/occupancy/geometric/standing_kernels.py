"""The loops of exact inference over bodies that stand, compiled.

A body is drawn once for the middle of each *block* of pixels where it can be,
in true perspective, as a map of heights; within the block, it is moved by whole
pixels. Numba keeps what it compiles beside this file, or in the user's cache
where that is read-only, so that only the first process pays.
"""

from typing import NamedTuple

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import draw_nearest
from xray_drake.kernels import kernel

_OUT = -1
"""What stands for the count of a candidate that does not keep in place."""

TILE = 4
"""Cells of a silhouette are compared in tiles so large: where all that is
observed is higher, or lower, than all of the tile, that is one comparison."""

_STRIDE = 11
"""Tiles are compared so far apart that what is plainly seen ends it early."""


class View(NamedTuple):
    """A camera as the compiled loops take it.

    Attributes:
        ray: 3×3, from pixels (u, v, 1) to world rays of unit z-depth.
        center: (3,) of the camera in the world, m.
        intrinsics: 3×3 camera matrix.
        rotation: 3×3 orientation of the camera in the world.
    """

    ray: np.ndarray
    center: np.ndarray
    intrinsics: np.ndarray
    rotation: np.ndarray

    @staticmethod
    def of(camera: PinholeCamera) -> "View":
        """Returns the view of a camera."""
        return View(
            np.ascontiguousarray(camera.pixel_to_ray),
            np.array(camera.X_WC[:3, 3]),
            # Copies: to numba, an array that may not be written is another
            # type.
            np.array(camera.intrinsics),
            np.array(camera.X_WC[:3, :3]),
        )


class Drawing(NamedTuple):
    """What a body is drawn by, wherever it is in the image.

    Attributes:
        vertices: (n, 3), turned; x and y from the axis, z from the floor, m.
        faces: (m, 3) indices of outward-facing triangles.
        reach: half width of what it is drawn on, pixels.
        middle: height at which the axis is seen at a pixel's centre, m.
        camera: as the loops take it.
    """

    vertices: np.ndarray
    faces: np.ndarray
    reach: int
    middle: float
    camera: View


class Tiles(NamedTuple):
    """A silhouette's cells, tile by tile; there is room for more of each.

    Attributes:
        corners: (many, 2) first row and column of a tile, from the middle.
        cells: (many, 2) index of its first cell, number of its cells.
        bounds: (many, 2) least and greatest height of them, m.
        places: (many, 2) row and column of a cell, from the middle.
        heights: (many,) of it, m.
    """

    corners: np.ndarray
    cells: np.ndarray
    bounds: np.ndarray
    places: np.ndarray
    heights: np.ndarray


@kernel()
def _canvas(drawing: Drawing) -> np.ndarray:
    """Returns what ``draw_body`` overwrites."""
    width = 2 * drawing.reach + 1
    return np.empty((width, width), dtype=np.float32)


@kernel()
def _room_for_runs(canvas: np.ndarray) -> np.ndarray:
    """Returns what ``_runs`` overwrites."""
    width = canvas.shape[0]
    return np.empty(((width // 2 + 1) * width, 3), dtype=np.int64)


@kernel()
def _room_for_tiles(canvas: np.ndarray) -> Tiles:
    """Returns what ``_tiles`` overwrites."""
    return Tiles(
        np.empty((canvas.size, 2), dtype=np.int64),
        np.empty((canvas.size, 2), dtype=np.int64),
        np.empty((canvas.size, 2), dtype=np.float32),
        np.empty((canvas.size, 2), dtype=np.int64),
        np.empty(canvas.size, dtype=np.float32),
    )


@kernel()
def _origin(u: float, v: float, drawing: Drawing) -> tuple[float, float]:
    """Returns x and y of the axis that is seen at a pixel."""
    ray, center = drawing.camera.ray, drawing.camera.center
    slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
    depth = (drawing.middle - center[2]) / slope
    x = center[0] + depth * (ray[0, 0] * u + ray[0, 1] * v + ray[0, 2])
    y = center[1] + depth * (ray[1, 0] * u + ray[1, 1] * v + ray[1, 2])
    return x, y


@kernel()
def draw_body(
    drawing: Drawing, pixel: np.ndarray, canvas: np.ndarray
) -> np.ndarray:
    """Draws a body as the camera sees it where its axis is at a pixel.

    Args:
        drawing: of the body.
        pixel: (2,) u, v of the axis.
        canvas: (2·reach + 1)² float32; overwritten with the height of what is
            seen of the body, m, or −1 beside it. ``pixel`` is in its middle.

    Returns:
        (4,) least u, greatest u, least v, greatest v, from ``pixel``.
    """
    vertices, reach = drawing.vertices, drawing.reach
    ray, center, intrinsics, rotation = drawing.camera
    x, y = _origin(pixel[0], pixel[1], drawing)
    count = len(vertices)
    points = np.empty((count, 2))
    nearness = np.empty(count)
    box = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for i in range(count):
        px = vertices[i, 0] + x - center[0]
        py = vertices[i, 1] + y - center[1]
        pz = vertices[i, 2] - center[2]
        cx = px * rotation[0, 0] + py * rotation[1, 0] + pz * rotation[2, 0]
        cy = px * rotation[0, 1] + py * rotation[1, 1] + pz * rotation[2, 1]
        cz = px * rotation[0, 2] + py * rotation[1, 2] + pz * rotation[2, 2]
        u = intrinsics[0, 0] * cx / cz + intrinsics[0, 2] - pixel[0]
        v = intrinsics[1, 1] * cy / cz + intrinsics[1, 2] - pixel[1]
        box[0], box[1] = min(box[0], u), max(box[1], u)
        box[2], box[3] = min(box[2], v), max(box[3], v)
        points[i, 0], points[i, 1] = u + reach, v + reach
        nearness[i] = 1.0 / cz
    canvas[:] = -1.0
    draw_nearest(points, nearness, drawing.faces, canvas)
    rows, columns = _spans(box, reach)
    for row in range(rows[0], rows[1]):
        for column in range(columns[0], columns[1]):
            if canvas[row, column] > 0.0:
                u = pixel[0] + column - reach
                v = pixel[1] + row - reach
                slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
                height = center[2] + slope / canvas[row, column]
                canvas[row, column] = max(height, 0.0)
    return box


@kernel()
def _draw_in_block(
    drawing: Drawing, corner: np.ndarray, side: int, canvas: np.ndarray
) -> np.ndarray:
    """Draws a body for the middle of a block; see ``draw_body``."""
    pixel = np.empty(2)
    pixel[0] = corner[1] + side // 2
    pixel[1] = corner[0] + side // 2
    return draw_body(drawing, pixel, canvas)


@kernel()
def _spans(
    box: np.ndarray, reach: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Returns the rows and columns of a canvas that a body's box covers."""
    most = 2 * reach + 1
    return (
        (
            max(int(np.floor(box[2])) + reach, 0),
            min(int(np.ceil(box[3])) + reach + 1, most),
        ),
        (
            max(int(np.floor(box[0])) + reach, 0),
            min(int(np.ceil(box[1])) + reach + 1, most),
        ),
    )


@kernel()
def _runs(canvas: np.ndarray, box: np.ndarray, runs: np.ndarray) -> int:
    """Lists a silhouette's runs; returns their number.

    Args:
        canvas: as from ``draw_body``.
        box: as from ``draw_body``.
        runs: (many, 3) overwritten: row, first column, one past the last, from
            the middle.
    """
    reach = canvas.shape[0] // 2
    count = 0
    rows, columns = _spans(box, reach)
    for row in range(rows[0], rows[1]):
        inside = False
        for column in range(columns[0], columns[1]):
            if canvas[row, column] >= 0.0:
                if not inside:
                    runs[count, 0] = row - reach
                    runs[count, 1] = column - reach
                    inside = True
            elif inside:
                runs[count, 2] = column - reach
                count += 1
                inside = False
        if inside:
            runs[count, 2] = columns[1] - reach
            count += 1
    return count


@kernel()
def _tiles(
    canvas: np.ndarray, box: np.ndarray, tiles: Tiles
) -> tuple[int, int]:
    """Sorts a silhouette's cells into tiles.

    Args:
        canvas: as from ``draw_body``.
        box: as from ``draw_body``.
        tiles: as from ``_room_for_tiles``; overwritten.

    Returns:
        The number of tiles and of cells.
    """
    reach = canvas.shape[0] // 2
    rows, columns = _spans(box, reach)
    down = (rows[1] - rows[0] + TILE - 1) // TILE
    across = (columns[1] - columns[0] + TILE - 1) // TILE
    number, area = 0, 0
    for first in range(_STRIDE):
        for i in range(first, down * across, _STRIDE):
            top = rows[0] + (i // across) * TILE
            left = columns[0] + (i % across) * TILE
            start = area
            low, high = np.inf, -np.inf
            for row in range(top, min(top + TILE, rows[1])):
                for column in range(left, min(left + TILE, columns[1])):
                    value = canvas[row, column]
                    if value >= 0.0:
                        tiles.places[area, 0] = row - reach
                        tiles.places[area, 1] = column - reach
                        tiles.heights[area] = value
                        area += 1
                        low, high = min(low, value), max(high, value)
            if area > start:
                tiles.corners[number, 0] = top - reach
                tiles.corners[number, 1] = left - reach
                tiles.cells[number, 0] = start
                tiles.cells[number, 1] = area - start
                tiles.bounds[number, 0] = low
                tiles.bounds[number, 1] = high
                number += 1
    return number, area


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


@kernel()
def _shows(
    v: int,
    u: int,
    number: int,
    tiles: Tiles,
    observed: np.ndarray,
    most: int,
) -> int:
    """Counts the pixels a candidate would show; stops beyond ``most``.

    Args:
        v: row of its axis.
        u: column of it.
        number: of tiles.
        tiles: as from ``_tiles``.
        observed: (3, H + 2·TILE, W + 2·TILE): heights of the observed surface
            with TILE more pixels on each side, m; the least and the greatest
            of the TILE² pixels right of and below each.
        most: pixels.
    """
    seen = 0
    for t in range(number):
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


@kernel()
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
    x, y = _origin(u, v, drawing)
    return room[0] <= x <= room[1] and room[2] <= y <= room[3]


@kernel()
def count_hidden(
    observed: np.ndarray,
    blocks: np.ndarray,
    side: int,
    step: int,
    weights: np.ndarray,
    allowed: float,
    drawing: Drawing,
    room: np.ndarray,
    change: np.ndarray,
) -> int:
    """Adds the candidates of one orientation that would not be seen.

    Args:
        observed: as in ``_shows``.
        blocks: (b, 2) first row and column of each block of candidates.
        side: of a block, pixels.
        step: between candidates, pixels.
        weights: (b,) what a candidate counts.
        allowed: share of its silhouette that it may show.
        drawing: of the body.
        room: as in ``_keeps``.
        change: (H, W + 1) raised in place: along a row, the differences of
            the sum of the accepted silhouettes.

    Returns:
        The number of accepted candidates.
    """
    shape = change.shape[0], change.shape[1] - 1
    canvas = _canvas(drawing)
    runs = _room_for_runs(canvas)
    tiles = _room_for_tiles(canvas)
    accepted = 0
    for b in range(len(blocks)):
        box = _draw_in_block(drawing, blocks[b], side, canvas)
        number, area = _tiles(canvas, box, tiles)
        if area == 0:
            continue
        lines = -1
        most = int(allowed * area)
        for v in range(blocks[b, 0], blocks[b, 0] + side, step):
            for u in range(blocks[b, 1], blocks[b, 1] + side, step):
                if not _keeps(u, v, box, shape, drawing, room):
                    continue
                seen = _shows(v, u, number, tiles, observed, most)
                if seen > most:
                    continue
                if lines < 0:
                    lines = _runs(canvas, box, runs)
                accepted += 1
                _add(change, runs, lines, v, u, weights[b])
    return accepted


@kernel()
def _add(
    change: np.ndarray,
    runs: np.ndarray,
    number: int,
    v: int,
    u: int,
    weight: float,
) -> None:
    height, width = change.shape[0], change.shape[1] - 1
    for i in range(number):
        row = v + runs[i, 0]
        if 0 <= row < height:
            change[row, min(max(u + runs[i, 1], 0), width)] += weight
            change[row, min(max(u + runs[i, 2], 0), width)] -= weight


@kernel()
def count_common(
    running: np.ndarray,
    blocks: np.ndarray,
    side: int,
    step: int,
    drawing: Drawing,
    room: np.ndarray,
) -> np.ndarray:
    """Counts the pixels that candidates share with the observed mask.

    Args:
        running: (H, W + 1) int32, sums of the mask along each row.
        blocks: as in ``count_hidden``.
        side: of a block, pixels.
        step: between candidates, pixels.
        drawing: of the body.
        room: as in ``_keeps``.

    Returns:
        (b, n, n) int32: of each block's candidates, by row and column; −1 for
        those that do not keep in place.
    """
    shape = running.shape[0], running.shape[1] - 1
    canvas = _canvas(drawing)
    runs = _room_for_runs(canvas)
    along = (side + step - 1) // step
    common = np.full((len(blocks), along, along), _OUT, dtype=np.int32)
    for b in range(len(blocks)):
        box = _draw_in_block(drawing, blocks[b], side, canvas)
        number = _runs(canvas, box, runs)
        for i in range(along):
            v = blocks[b, 0] + i * step
            for k in range(along):
                u = blocks[b, 1] + k * step
                if not _keeps(u, v, box, shape, drawing, room):
                    continue
                total = 0
                for j in range(number):
                    row = v + runs[j, 0]
                    if 0 <= row < shape[0]:
                        first = min(max(u + runs[j, 1], 0), shape[1])
                        last = min(max(u + runs[j, 2], 0), shape[1])
                        total += running[row, last] - running[row, first]
                common[b, i, k] = total
    return common


@kernel()
def count_shown(
    observed: np.ndarray,
    common: np.ndarray,
    least: float,
    blocks: np.ndarray,
    side: int,
    step: int,
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
        blocks: as in ``count_hidden``.
        side: of a block, pixels.
        step: between candidates, pixels.
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
    canvas = _canvas(drawing)
    tiles = _room_for_tiles(canvas)
    shown = np.full(common.shape, _OUT, dtype=np.int32)
    size, share, trusted, spread = limits[0], limits[1], limits[2], limits[3]
    by_coverage = limits[4] > 0.0
    for b in range(len(blocks)):
        if common[b].max() < least:
            continue
        box = _draw_in_block(drawing, blocks[b], side, canvas)
        number, area = _tiles(canvas, box, tiles)
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
                seen = _shows(v, u, number, tiles, observed, most)
                shown[b, i, k] = area if seen > most else seen
                if seen <= most:
                    iou = together / (seen + size - together)
                    best[0] = max(best[0], iou)
                    best[1] = min(best[1], seen - together)
    return shown


@kernel()
def add_accepted(
    accepted: np.ndarray,
    weights: np.ndarray,
    blocks: np.ndarray,
    side: int,
    step: int,
    drawing: Drawing,
    change: np.ndarray,
) -> None:
    """Adds the silhouettes of accepted candidates.

    Args:
        accepted: (b, n, n) bool: of each block's candidates.
        weights: (b,) what a candidate counts.
        blocks: as in ``count_hidden``.
        side: of a block, pixels.
        step: between candidates, pixels.
        drawing: of the body.
        change: as in ``count_hidden``.
    """
    canvas = _canvas(drawing)
    runs = _room_for_runs(canvas)
    for b in range(len(blocks)):
        if not accepted[b].any():
            continue
        box = _draw_in_block(drawing, blocks[b], side, canvas)
        number = _runs(canvas, box, runs)
        for i in range(accepted.shape[1]):
            for k in range(accepted.shape[2]):
                if accepted[b, i, k]:
                    v = blocks[b, 0] + i * step
                    u = blocks[b, 1] + k * step
                    _add(change, runs, number, v, u, weights[b])
