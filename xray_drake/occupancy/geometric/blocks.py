"""Blocks of pixels where a standing body's axis may be."""

from dataclasses import dataclass

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.standing import StandingTarget
from xray_drake.occupancy.geometric.standing_drawing import View

_COVERED = 0.8
"""A hidden target's surroundings hide at least this share of its area ..."""

_QUANTILE, _TALL = 0.4, 0.4
"""... and so high as ``_QUANTILE`` of its area is, at least ``_TALL`` of it."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Squares of pixels where a body's axis may be.

    Attributes:
        corners: (b, 2) first row and column of each.
        side: pixels.
    """

    corners: np.ndarray
    side: int

    def pixels(self, step: int) -> np.ndarray:
        """Returns (n, 2) u, v of the candidates, ``step`` pixels apart."""
        along = np.arange(0, self.side, step)
        v = self.corners[:, 0, None, None] + along[:, None]
        u = self.corners[:, 1, None, None] + along[None]
        v, u = np.broadcast_arrays(v, u)
        return np.column_stack([u.ravel(), v.ravel()])

    @staticmethod
    def over(
        rows: tuple[int, int], columns: tuple[int, int], side: int
    ) -> "Blocks":
        """Covers first to last row and column."""
        v, u = np.meshgrid(
            np.arange(rows[0], rows[1] + 1, side),
            np.arange(columns[0], columns[1] + 1, side),
            indexing="ij",
        )
        return Blocks(np.column_stack([v.ravel(), u.ravel()]), side)

    @staticmethod
    def around(places: np.ndarray, side: int) -> "Blocks":
        """Covers (n, 2) rows and columns, and the pixels next to them."""
        steps = np.array([[v, u] for v in (-1, 0, 1) for u in (-1, 0, 1)])
        beside = (places[:, None] + steps).reshape(-1, 2)
        corners = np.unique(beside // side, axis=0) * side
        return Blocks(np.ascontiguousarray(corners), side)

    @staticmethod
    def on_floor(
        body: StandingTarget, camera: PinholeCamera, floor: Floor
    ) -> "Blocks":
        """Covers where the axis of a body on the floor is in the image."""
        corners = np.pad(
            floor.corners(), ((0, 0), (0, 1)), constant_values=body.middle
        )
        uv = camera.project(corners)[:, :2]
        high = np.array([camera.width - 1, camera.height - 1])
        first = np.floor(uv.min(axis=0)).clip(0, high).astype(int)
        last = np.ceil(uv.max(axis=0)).clip(0, high).astype(int)
        return Blocks.over(
            (first[1], last[1]),
            (first[0], last[0]),
            body.block_side(camera),
        )

    def that_hide(
        self,
        body: StandingTarget,
        heights: np.ndarray,
        view: View,
        reach: int,
    ) -> "Blocks":
        """Leaves out blocks around which too little could hide a body.

        Args:
            body: which.
            heights: (H, W) of the observed surface, m.
            view: the camera.
            reach: half width of its drawing, pixels.
        """
        middle = np.array(heights.shape[::-1]) / 2
        drawn = body.draw(0.0, middle, view, reach)
        own = drawn[drawn >= 0]
        tall = float(np.quantile(own, _QUANTILE))
        keep = np.ones(len(self.corners), dtype=bool)
        width = 2 * reach + 1 + self.side
        for level, share in ((1e-3, _COVERED), (0.98 * tall, _TALL)):
            hides = (heights >= level).astype(np.float32)
            around = cv2.boxFilter(
                hides,
                cv2.CV_32F,
                (width, width),
                normalize=False,
                borderType=cv2.BORDER_CONSTANT,
            )
            at = np.minimum(
                self.corners + self.side // 2, np.array(heights.shape) - 1
            )
            keep &= around[at[:, 0], at[:, 1]] >= share * len(own)
        return Blocks(np.ascontiguousarray(self.corners[keep]), self.side)

    def weights(
        self, body: StandingTarget, camera: PinholeCamera
    ) -> np.ndarray:
        """Returns (b,) floor per pixel, times the pose's probability.

        A pixel at z-depth d shows d³/(f²·c) of a plane c below the camera.
        """
        middle = self.corners + self.side // 2
        ray = camera.pixel_to_ray
        slope = ray[2, 0] * middle[:, 1] + ray[2, 1] * middle[:, 0] + ray[2, 2]
        with np.errstate(divide="ignore"):
            relative = np.maximum(-1 / slope, 0.0) ** 3
        return body.probability * relative
