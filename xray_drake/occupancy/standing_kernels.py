"""The loops of exact inference over bodies that stand, compiled.

A body is drawn once for the middle of each *block* of pixels where it can be,
in true perspective, as a map of heights; within the block, it is moved by whole
pixels. Numba keeps what it compiles beside this file, or in the user's cache
where that is read-only, so that only the first process pays.
"""

import numpy as np
from numba import njit

from xray_drake.geometry.height_map import draw_nearest

_OUT = -1
"""What stands for the count of a candidate that does not keep in place."""

_STRIDE = 37
"""Cells are compared so far apart, that what is plainly seen ends it early."""


@njit(cache=True)
def _origin(
    u: float, v: float, height: float, ray: np.ndarray, center: np.ndarray
) -> tuple[float, float]:
    """Returns x and y, on the plane z = ``height``, of what a pixel shows."""
    slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
    depth = (height - center[2]) / slope
    x = center[0] + depth * (ray[0, 0] * u + ray[0, 1] * v + ray[0, 2])
    y = center[1] + depth * (ray[1, 0] * u + ray[1, 1] * v + ray[1, 2])
    return x, y


@njit(cache=True)
def draw_body(
    vertices: np.ndarray,
    faces: np.ndarray,
    pixel: np.ndarray,
    middle: float,
    ray: np.ndarray,
    center: np.ndarray,
    intrinsics: np.ndarray,
    rotation: np.ndarray,
    canvas: np.ndarray,
) -> np.ndarray:
    """Draws a body as the camera sees it where its axis is at a pixel.

    Args:
        vertices: (n, 3), turned; x and y from the axis, z from the floor, m.
        faces: (m, 3) indices of outward-facing triangles.
        pixel: (2,) u, v of the axis at height ``middle``.
        middle: m.
        ray: 3×3, from pixels (u, v, 1) to world rays of unit z-depth.
        center: (3,) the camera's, in the world, m.
        intrinsics: 3×3 camera matrix.
        rotation: 3×3 orientation of the camera in the world.
        canvas: (2·reach + 1)² float32; overwritten with the height of what is
            seen of the body, m, or −1 beside it. ``pixel`` is in its middle.

    Returns:
        (4,) least u, greatest u, least v, greatest v, from ``pixel``.
    """
    reach = canvas.shape[0] // 2
    x, y = _origin(pixel[0], pixel[1], middle, ray, center)
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
    canvas[:] = 0.0
    draw_nearest(points, nearness, faces, canvas)
    for row in range(canvas.shape[0]):
        for column in range(canvas.shape[1]):
            if canvas[row, column] > 0.0:
                u = pixel[0] + column - reach
                v = pixel[1] + row - reach
                slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
                height = center[2] + slope / canvas[row, column]
                canvas[row, column] = max(height, 0.0)
            else:
                canvas[row, column] = -1.0
    return box


@njit(cache=True)
def _runs(canvas: np.ndarray, runs: np.ndarray) -> tuple[int, int]:
    """Lists a silhouette's runs; returns their number and its area.

    Args:
        canvas: as from ``draw_body``.
        runs: (many, 3) overwritten: row, first column, one past the last, from
            the middle.
    """
    reach = canvas.shape[0] // 2
    count, area = 0, 0
    for row in range(canvas.shape[0]):
        inside = False
        for column in range(canvas.shape[1]):
            if canvas[row, column] >= 0.0:
                area += 1
                if not inside:
                    runs[count, 0] = row - reach
                    runs[count, 1] = column - reach
                    inside = True
            elif inside:
                runs[count, 2] = column - reach
                count += 1
                inside = False
        if inside:
            runs[count, 2] = canvas.shape[1] - reach
            count += 1
    return count, area


@njit(cache=True)
def _cells(
    canvas: np.ndarray,
    places: np.ndarray,
    heights: np.ndarray,
    ordered: np.ndarray,
) -> int:
    """Lists a silhouette's cells, neighbours far apart; returns their number.

    Args:
        canvas: as from ``draw_body``.
        places: (many, 2) overwritten: row and column from the middle.
        heights: (many,) overwritten, m.
        ordered: (many, 2), room to work in.
    """
    reach = canvas.shape[0] // 2
    count = 0
    for row in range(canvas.shape[0]):
        for column in range(canvas.shape[1]):
            if canvas[row, column] >= 0.0:
                ordered[count, 0], ordered[count, 1] = row, column
                count += 1
    k = 0
    for first in range(_STRIDE):
        for i in range(first, count, _STRIDE):
            row, column = ordered[i, 0], ordered[i, 1]
            places[k, 0], places[k, 1] = row - reach, column - reach
            heights[k] = canvas[row, column]
            k += 1
    return count


@njit(cache=True)
def _keeps(
    u: int,
    v: int,
    box: np.ndarray,
    shape: tuple[int, int],
    middle: float,
    ray: np.ndarray,
    center: np.ndarray,
    room: np.ndarray,
) -> bool:
    """Says whether a candidate keeps within image and bin.

    Args:
        u: column of its axis.
        v: row of it.
        box: what ``draw_body`` returned.
        shape: height and width of the image.
        middle: height at which the axis is seen, m.
        ray: as in ``draw_body``.
        center: as in ``draw_body``.
        room: (4,) x low, x high, y low, y high of the axis, m.
    """
    if u + box[0] < -0.5 or u + box[1] > shape[1] - 0.5:
        return False
    if v + box[2] < -0.5 or v + box[3] > shape[0] - 0.5:
        return False
    x, y = _origin(u, v, middle, ray, center)
    return room[0] <= x <= room[1] and room[2] <= y <= room[3]


@njit(cache=True)
def count_hidden(
    observed: np.ndarray,
    blocks: np.ndarray,
    side: int,
    weights: np.ndarray,
    allowed: float,
    vertices: np.ndarray,
    faces: np.ndarray,
    reach: int,
    middle: float,
    ray: np.ndarray,
    center: np.ndarray,
    intrinsics: np.ndarray,
    rotation: np.ndarray,
    room: np.ndarray,
    change: np.ndarray,
) -> int:
    """Adds the candidates of one orientation that would not be seen.

    Args:
        observed: (H, W) height of the observed surface, m; −inf where there
            is no reading.
        blocks: (b, 2) first row and column of each block of candidates.
        side: of a block, pixels.
        weights: (b,) what a candidate counts.
        allowed: share of its silhouette that it may show.
        vertices: as in ``draw_body``, and so are ``faces``, ``middle``,
            ``ray``, ``center``, ``intrinsics`` and ``rotation``.
        reach: half width of what a body is drawn on, pixels.
        room: as in ``_keeps``.
        change: (H, W + 1) raised in place: along a row, the differences of
            the sum of the accepted silhouettes.

    Returns:
        The number of accepted candidates.
    """
    shape = observed.shape
    canvas = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    runs = np.empty(((reach + 1) * (2 * reach + 1), 3), dtype=np.int64)
    places = np.empty((canvas.size, 2), dtype=np.int64)
    spare = np.empty((canvas.size, 2), dtype=np.int64)
    heights = np.empty(canvas.size, dtype=np.float32)
    pixel = np.empty(2)
    accepted = 0
    for b in range(len(blocks)):
        pixel[0] = blocks[b, 1] + side // 2
        pixel[1] = blocks[b, 0] + side // 2
        box = draw_body(
            vertices, faces, pixel, middle, ray, center, intrinsics, rotation,
            canvas,
        )
        area = _cells(canvas, places, heights, spare)
        if area == 0:
            continue
        number = -1
        most = int(allowed * area)
        for v in range(blocks[b, 0], blocks[b, 0] + side):
            for u in range(blocks[b, 1], blocks[b, 1] + side):
                if not _keeps(u, v, box, shape, middle, ray, center, room):
                    continue
                seen = 0
                for i in range(area):
                    row, column = v + places[i, 0], u + places[i, 1]
                    if not (0 <= row < shape[0] and 0 <= column < shape[1]):
                        continue
                    if observed[row, column] < heights[i]:
                        seen += 1
                        if seen > most:
                            break
                if seen > most:
                    continue
                if number < 0:
                    number, _ = _runs(canvas, runs)
                accepted += 1
                _add(change, runs, number, v, u, weights[b])
    return accepted


@njit(cache=True)
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


@njit(cache=True)
def count_common(
    running: np.ndarray,
    blocks: np.ndarray,
    side: int,
    step: int,
    vertices: np.ndarray,
    faces: np.ndarray,
    reach: int,
    middle: float,
    ray: np.ndarray,
    center: np.ndarray,
    intrinsics: np.ndarray,
    rotation: np.ndarray,
    room: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Counts the pixels that candidates share with the observed mask.

    Args:
        running: (H, W + 1) int32, sums of the mask along each row.
        step: between candidates, pixels.

    The others are as in ``count_hidden``.

    Returns:
        (b, n, n) int32: of each block's candidates, by row and column; −1 for
        those that do not keep in place. (b,) area of the silhouettes, pixels.
    """
    shape = running.shape[0], running.shape[1] - 1
    canvas = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    runs = np.empty(((reach + 1) * (2 * reach + 1), 3), dtype=np.int64)
    pixel = np.empty(2)
    along = (side + step - 1) // step
    common = np.full((len(blocks), along, along), _OUT, dtype=np.int32)
    areas = np.zeros(len(blocks), dtype=np.int64)
    for b in range(len(blocks)):
        pixel[0] = blocks[b, 1] + side // 2
        pixel[1] = blocks[b, 0] + side // 2
        box = draw_body(
            vertices, faces, pixel, middle, ray, center, intrinsics, rotation,
            canvas,
        )
        number, areas[b] = _runs(canvas, runs)
        for i in range(along):
            v = blocks[b, 0] + i * step
            for k in range(along):
                u = blocks[b, 1] + k * step
                if not _keeps(u, v, box, shape, middle, ray, center, room):
                    continue
                total = 0
                for j in range(number):
                    row = v + runs[j, 0]
                    if 0 <= row < shape[0]:
                        first = min(max(u + runs[j, 1], 0), shape[1])
                        last = min(max(u + runs[j, 2], 0), shape[1])
                        total += running[row, last] - running[row, first]
                common[b, i, k] = total
    return common, areas


@njit(cache=True)
def count_shown(
    observed: np.ndarray,
    mask: np.ndarray,
    common: np.ndarray,
    least: float,
    blocks: np.ndarray,
    side: int,
    step: int,
    size: int,
    by_iou: bool,
    share: float,
    trusted: float,
    best: float,
    vertices: np.ndarray,
    faces: np.ndarray,
    reach: int,
    middle: float,
    ray: np.ndarray,
    center: np.ndarray,
    intrinsics: np.ndarray,
    rotation: np.ndarray,
) -> tuple[np.ndarray, float]:
    """Counts the pixels that candidates would show.

    Counting ends early where the candidate cannot reach ``share`` of the best
    IoU found so far, if that is trusted; its count is then the whole
    silhouette.

    Args:
        observed: (H, W) as in ``count_hidden``.
        mask: (H, W) bool, the observed modal mask, where the target shows.
        common: as from ``count_common``.
        least: candidates that share fewer pixels are left out.
        size: pixels of the mask.
        by_iou: counting may end early.
        share: of the best IoU that is asked for.
        trusted: the least IoU by which is decided.
        best: the best IoU so far.

    The others are as in ``count_common``.

    Returns:
        (b, n, n) int32, −1 for those left out; the best IoU.
    """
    shape = observed.shape
    canvas = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    places = np.empty((canvas.size, 2), dtype=np.int64)
    spare = np.empty((canvas.size, 2), dtype=np.int64)
    heights = np.empty(canvas.size, dtype=np.float32)
    pixel = np.empty(2)
    shown = np.full(common.shape, _OUT, dtype=np.int32)
    for b in range(len(blocks)):
        if common[b].max() < least:
            continue
        pixel[0] = blocks[b, 1] + side // 2
        pixel[1] = blocks[b, 0] + side // 2
        draw_body(
            vertices, faces, pixel, middle, ray, center, intrinsics, rotation,
            canvas,
        )
        area = _cells(canvas, places, heights, spare)
        for i in range(common.shape[1]):
            v = blocks[b, 0] + i * step
            for k in range(common.shape[2]):
                together = common[b, i, k]
                if together < least:
                    continue
                u = blocks[b, 1] + k * step
                most = area
                if by_iou and best >= trusted:
                    # together / (seen + size − together) ≥ share · best
                    bound = together / (share * best) - size + together
                    most = min(most, int(bound) + 1)
                seen = 0
                for j in range(area):
                    row, column = v + places[j, 0], u + places[j, 1]
                    if not (0 <= row < shape[0] and 0 <= column < shape[1]):
                        continue
                    if (
                        mask[row, column]
                        or observed[row, column] < heights[j]
                    ):
                        seen += 1
                        if seen > most:
                            break
                shown[b, i, k] = area if seen > most else seen
                if seen <= most:
                    best = max(best, together / (seen + size - together))
    return shown, best


@njit(cache=True)
def add_accepted(
    accepted: np.ndarray,
    weights: np.ndarray,
    blocks: np.ndarray,
    side: int,
    step: int,
    vertices: np.ndarray,
    faces: np.ndarray,
    reach: int,
    middle: float,
    ray: np.ndarray,
    center: np.ndarray,
    intrinsics: np.ndarray,
    rotation: np.ndarray,
    change: np.ndarray,
) -> None:
    """Adds the silhouettes of the (b, n, n) bool ``accepted`` candidates.

    The others are as in ``count_hidden`` and ``count_common``.
    """
    canvas = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    runs = np.empty(((reach + 1) * (2 * reach + 1), 3), dtype=np.int64)
    pixel = np.empty(2)
    for b in range(len(blocks)):
        if not accepted[b].any():
            continue
        pixel[0] = blocks[b, 1] + side // 2
        pixel[1] = blocks[b, 0] + side // 2
        draw_body(
            vertices, faces, pixel, middle, ray, center, intrinsics, rotation,
            canvas,
        )
        number, _ = _runs(canvas, runs)
        for i in range(accepted.shape[1]):
            for k in range(accepted.shape[2]):
                if accepted[b, i, k]:
                    v = blocks[b, 0] + i * step
                    u = blocks[b, 1] + k * step
                    _add(change, runs, number, v, u, weights[b])
