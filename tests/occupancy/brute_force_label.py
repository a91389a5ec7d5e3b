"""The label of PROTOCOL.md, one candidate after the other.

Slow and plain: each candidate is placed in the image as lists of pixels and
depths and compared with the scene. Shares no code with the fast label but the
camera and the numbers.
"""

import numpy as np

from tests.nominal import BIN
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.label.config import LabelConfig


def brute_force_label(
    target_depth: np.ndarray,
    scene_depth: np.ndarray,
    camera: PinholeCamera,
    p_WT: np.ndarray,
    observed: np.ndarray | None = None,
    config: LabelConfig | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Returns the distribution, the modal mask and the number accepted."""
    config = config or LabelConfig()
    height, width = camera.shape
    T, S = target_depth.astype(float), scene_depth.astype(float)
    floor = camera.plane_depth(0.0)
    ground = camera.unproject(floor)
    (x_low, x_high), (y_low, y_high) = BIN.floor.x, BIN.floor.y
    slack = config.floor_tolerance
    on_floor = (ground[..., 0] >= x_low - slack) & (
        ground[..., 0] <= x_high + slack
    )
    on_floor &= (ground[..., 1] >= y_low - slack) & (
        ground[..., 1] <= y_high + slack
    )
    no_reading = ~((S > 0) & np.isfinite(S))

    def in_front(
        depth: np.ndarray, rows: np.ndarray, columns: np.ndarray
    ) -> np.ndarray:
        nearer = depth < S[rows, columns] - config.depth_tolerance
        return nearer | no_reading[rows, columns]

    amodal = (T > 0) & np.isfinite(T)
    rows, columns = np.nonzero(amodal)
    if observed is None:
        modal = np.zeros_like(amodal)
        modal[rows, columns] = in_front(T[amodal], rows, columns)
    else:
        modal = observed
    size = np.count_nonzero(modal)

    total = np.zeros(camera.shape, dtype=int)
    count = 0
    contradiction = size == 0 and in_front(T[amodal], rows, columns).all()
    if not contradiction:
        total[amodal] += 1
        count += 1
    u0, v0 = camera.project(p_WT)[:2]
    u_pixel, v_pixel = round_up(np.array([u0, v0]))
    for k in range(config.rotations):
        v, u, depth, floor_before = rotated(
            T, floor, u0, v0, 2 * np.pi * k / config.rotations
        )
        if not len(v):
            continue
        top, bottom, left, right = v.min(), v.max(), u.min(), u.max()
        for v_new in range(v_pixel % config.step, height, config.step):
            dv = v_new - v_pixel
            if top + dv < 0 or bottom + dv >= height:
                continue
            for u_new in range(u_pixel % config.step, width, config.step):
                du = u_new - u_pixel
                if left + du < 0 or right + du >= width:
                    continue
                if k == 0 and du == 0 and dv == 0:
                    continue  # the true pose, counted before
                box = modal[
                    top + dv : bottom + dv + 1, left + du : right + du + 1
                ]
                if size > 0 and not box.any():
                    continue  # nothing in common, an IoU of 0
                rows, columns = v + dv, u + du
                if not on_floor[rows, columns].all():
                    continue
                moved = depth + floor[rows, columns] - floor_before
                seen = in_front(moved, rows, columns)
                if size == 0:
                    accept = not seen.any()
                else:
                    common = np.count_nonzero(modal[rows, columns] & seen)
                    union = size + np.count_nonzero(seen) - common
                    accept = common / union > config.accept_iou
                if accept:
                    total[rows, columns] += 1
                    count += 1
    largest = max(total.max(), 1)
    distribution = total.astype(np.float32) / np.float32(largest)
    return distribution, modal, count


def rotated(
    T: np.ndarray, floor: np.ndarray, u0: float, v0: float, angle: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotates the target about (u0, v0).

    Returns:
        rows and columns, which may be outside the image, the depths there and
        the floor's depths where they come from.
    """
    height, width = T.shape
    rows, columns = np.nonzero((T > 0) & np.isfinite(T))
    reach = int(np.hypot(columns - u0, rows - v0).max()) + 3
    v, u = np.mgrid[
        int(v0) - reach : int(v0) + reach + 1,
        int(u0) - reach : int(u0) + reach + 1,
    ]
    c, s = np.cos(angle).round(12), np.sin(angle).round(12)
    u_from = round_up(u0 + c * (u - u0) + s * (v - v0))
    v_from = round_up(v0 - s * (u - u0) + c * (v - v0))
    within = (
        (u_from >= 0) & (u_from < width) & (v_from >= 0) & (v_from < height)
    )
    u, v, u_from, v_from = (a[within] for a in (u, v, u_from, v_from))
    depth = T[v_from, u_from]
    covered = (depth > 0) & np.isfinite(depth)
    return (
        v[covered],
        u[covered],
        depth[covered],
        floor[v_from, u_from][covered],
    )


def round_up(values: np.ndarray) -> np.ndarray:
    """Rounds to the nearest integers, halves (to a millionth) up."""
    return np.floor(values + 0.5 + 1e-6).astype(int)
