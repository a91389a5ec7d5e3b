"""A pinhole camera: what perception needs to know of the sensor."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """Intrinsics and pose of a camera, as they travel over a port.

    Attributes:
        width: image width in pixels.
        height: image height in pixels.
        intrinsics: 3×3 camera matrix, pixels. Pixel centres are at integers.
        X_WC: 4×4 pose of the camera frame (x right, y down, z forward) in the
            world, m.
    """

    width: int
    height: int
    intrinsics: np.ndarray
    X_WC: np.ndarray

    def __post_init__(self) -> None:
        K = np.array(self.intrinsics, dtype=float)
        X = np.array(self.X_WC, dtype=float)
        if K.shape != (3, 3) or X.shape != (4, 4):
            raise ValueError(
                f"a camera needs a 3×3 matrix and a 4×4 pose, not {K.shape} "
                f"and {X.shape}"
            )
        K.setflags(write=False)
        X.setflags(write=False)
        object.__setattr__(self, "intrinsics", K)
        object.__setattr__(self, "X_WC", X)

    def __deepcopy__(self, memo: dict) -> "PinholeCamera":
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of its images, ``(height, width)``."""
        return self.height, self.width

    def cropped(self, rows: slice, columns: slice) -> "PinholeCamera":
        """Returns the camera of a part of its images."""
        K = np.array(self.intrinsics)
        K[:2, 2] -= columns.start, rows.start
        return PinholeCamera(
            columns.stop - columns.start, rows.stop - rows.start, K, self.X_WC
        )

    def padded(self, height: int, width: int) -> "PinholeCamera":
        """Returns the camera of its images with more rows and columns.

        They are added below and on the right.

        Args:
            height: no less than its own, pixels.
            width: likewise.
        """
        return PinholeCamera(width, height, self.intrinsics, self.X_WC)

    def resized(self, width: int, height: int) -> "PinholeCamera":
        """Returns the camera of its images in another size.

        The images show the same: pixel i of n spans [i − ½, i + ½], and all n
        together are stretched over the new ones.

        Args:
            width: pixels, at least 1.
            height: likewise.
        """
        scale = np.array([width / self.width, height / self.height])
        K = np.array(self.intrinsics)
        K[:2] *= scale[:, None]
        K[:2, 2] += (scale - 1) / 2
        return PinholeCamera(width, height, K, self.X_WC)

    def zoomed(self, factor: float) -> "PinholeCamera":
        """Returns the camera of its images scaled about their centre.

        The images keep their size: where ``factor`` is below 1 they show what
        surrounds the old ones, above 1 their middle alone.

        Args:
            factor: above 0.
        """
        center = np.array([self.width - 1, self.height - 1]) / 2
        K = np.array(self.intrinsics)
        K[:2] *= factor
        K[:2, 2] += (1 - factor) * center
        return PinholeCamera(self.width, self.height, K, self.X_WC)

    @property
    def floor_scale(self) -> float:
        """Pixels per metre of the floor, as seen from straight above."""
        return float(self.intrinsics[0, 0] / self.X_WC[2, 3])

    def project(self, p_W: np.ndarray) -> np.ndarray:
        """Projects points.

        Args:
            p_W: (..., 3) points in the world, m.

        Returns:
            (..., 3) array of u, v in pixels and z-depth in m.
        """
        R, t = self.X_WC[:3, :3], self.X_WC[:3, 3]
        p_C = (np.asarray(p_W, dtype=float) - t) @ R
        K = self.intrinsics
        z = p_C[..., 2]
        u = K[0, 0] * p_C[..., 0] / z + K[0, 2]
        v = K[1, 1] * p_C[..., 1] / z + K[1, 2]
        return np.stack([u, v, z], axis=-1)

    @property
    def pixel_to_ray(self) -> np.ndarray:
        """The 3×3 map from (u, v, 1) to world rays of unit z-depth."""
        K = self.intrinsics
        from_pixel = np.array(
            [
                [1 / K[0, 0], 0.0, -K[0, 2] / K[0, 0]],
                [0.0, 1 / K[1, 1], -K[1, 2] / K[1, 1]],
                [0.0, 0.0, 1.0],
            ]
        )
        return np.ascontiguousarray(self.X_WC[:3, :3] @ from_pixel)

    def rays(self) -> np.ndarray:
        """Returns (H, W, 3): per pixel, p_W − camera centre at unit z-depth."""
        K = self.intrinsics
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        d_C = np.stack(
            [
                (u - K[0, 2]) / K[0, 0],
                (v - K[1, 2]) / K[1, 1],
                np.ones(self.shape),
            ],
            axis=-1,
        )
        return d_C @ self.X_WC[:3, :3].T

    def plane_depth(self, height: float) -> np.ndarray:
        """Returns the (H, W) z-depth of the world plane ``z = height``, m.

        Rays that never meet the plane get ``inf``.
        """
        slope = self.rays()[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (height - self.X_WC[2, 3]) / slope
        return np.where((slope != 0) & (depth > 0), depth, np.inf)

    def unproject(self, depth: np.ndarray) -> np.ndarray:
        """Returns the (H, W, 3) world points of an (H, W) z-depth image, m."""
        with np.errstate(invalid="ignore"):  # no reading: 0 × inf
            return self.X_WC[:3, 3] + self.rays() * depth[..., None]

    def plane_homography(self, height: float) -> np.ndarray:
        """Returns the 3×3 map from (x, y, 1) on ``z = height`` to pixels."""
        X_CW = np.linalg.inv(self.X_WC)
        plane = np.array([[1, 0, 0], [0, 1, 0], [0, 0, height], [0, 0, 1]])
        return self.intrinsics @ (X_CW @ plane)[:3]
