"""Poses of a flat target that is partly seen: counted in the image itself.

Near the place where the target is seen, moving it over the floor moves its
silhouette by whole pixels without changing it by more than a fraction of one.
"""

import cv2
import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import Spans, convex_spans
from xray_drake.occupancy.geometric.acceptance import SLACK, AcceptanceRule
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.flat_target import FlatTarget
from xray_drake.occupancy.geometric.pose_search import PoseSearch, paste
from xray_drake.occupancy.geometric.spectra import inverse

_EXACT_WORK = 1_000_000
"""Rows times corners of all of them up to which that is done: where more are
near, none decides alone."""


def count_seen(search: PoseSearch, config: GeometricConfig) -> np.ndarray:
    """Counts the accepted poses of a target that is seen, per pixel.

    Args:
        search: what its poses would show.
        config: the rules of acceptance.

    Returns:
        (H, W) float32: by how many accepted poses a pixel is covered; the mask
        itself where no candidate meets it.
    """
    target, mask, camera = search.target, search.mask, search.camera
    size = int(np.count_nonzero(mask))
    typical = float(search.silhouettes.sum(axis=(1, 2)).mean())
    most = search.common.amax(dim=(1, 2))
    if most.max() <= 0:
        return mask.astype(np.float32)

    # IoU ≤ common / size, so orientations that cover too little are out.
    rule = AcceptanceRule(config, size, typical)
    chosen = (most >= rule.least_common(float(most.max()))).nonzero()[:, 0]
    common = search.common[chosen]
    area = search.areas(chosen)
    near = rule.accepted(common, area, slack=SLACK)
    if target.convex:
        poses = near.nonzero()
        work = len(poses) * (2 * search.reach + 1) * search.corners
        if work <= _EXACT_WORK:
            pixels = poses[:, [2, 1]].numpy() + [search.left, search.top]
            spans = _spans(
                target,
                search.angles[chosen[poses[:, 0]].numpy()],
                pixels,
                camera,
            )
            accepted = rule.accepted(
                torch.from_numpy(spans.sums(mask)),
                torch.from_numpy(spans.sums(search.would_show)),
            )
            return spans.total(accepted.numpy())

    shape = search.window.shape
    total = torch.zeros_like(search.spectra[0])
    for k, poses in zip(chosen, rule.accepted(common, area), strict=True):
        if poses.any():
            placed = torch.zeros(shape)
            placed[search.tried] = poses.to(torch.float32)
            total += torch.fft.rfft2(placed) * search.spectra[k]
    return paste(
        inverse(total, shape).round_().numpy(), search.window, camera.shape
    )


def _spans(
    target: FlatTarget,
    angles: np.ndarray,
    pixels: np.ndarray,
    camera: PinholeCamera,
) -> Spans:
    """Draws n poses of a convex target, each where it really is seen."""
    outlines = []
    for angle in np.unique(angles):
        corners = target.project(angle, pixels[angles == angle], camera)
        around = cv2.convexHull(
            corners[0].astype(np.float32), returnPoints=False
        )[:, 0]
        outlines.append(corners[:, around])
    corners_most = max(outline.shape[1] for outline in outlines)
    return convex_spans(
        np.concatenate(
            [
                np.pad(
                    outline,
                    ((0, 0), (0, corners_most - outline.shape[1]), (0, 0)),
                    mode="edge",
                )
                for outline in outlines
            ]
        ),
        camera.shape,
    )
