"""A target that stands on the floor in one of its resting poses."""

import numpy as np
import trimesh

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.geometry.resting import (
    RestingPose,
    standing,
    turns_into_itself,
)
from xray_drake.occupancy.geometric.standing_drawing import (
    Drawing,
    View,
    draw_body,
)

_DRIFT = 0.35
"""Pixels by which a silhouette may be off within a block of candidates."""

_LARGEST_BLOCK = 16


class StandingTarget:
    """A target in one resting pose, with any turn about the vertical.

    Attributes:
        probability: of the pose.
        vertices: (n, 3), m; x and y from the vertical *axis* through the
            centre of mass, z from the floor.
        faces: (m, 3) indices of outward-facing triangles.
        height: of the highest point, m.
        middle: half of it: where the axis is seen at a pixel's centre.
        radius: largest distance of a vertex from the axis, m.
        symmetry: turns by 1/symmetry look the same.
    """

    def __init__(
        self, mesh: trimesh.Trimesh, p_OCom: np.ndarray, pose: RestingPose
    ) -> None:
        """Puts a closed mesh, given in the body frame (m), on the floor."""
        self.probability = pose.probability
        self.vertices = standing(mesh.vertices, pose.R_WO)
        self.vertices[:, :2] -= (pose.R_WO @ p_OCom)[:2]
        self.faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
        self.height = float(self.vertices[:, 2].max())
        self.middle = self.height / 2
        self.radius = float(np.hypot(*self.vertices[:, :2].T).max())
        self.symmetry = turns_into_itself(self.vertices, self.faces)

    def angles(self, rotations: int, times: int = 1) -> np.ndarray:
        """Returns the (k,) distinct of equally spaced angles, rad.

        Args:
            rotations: over the full turn.
            times: so many times as many, between those.
        """
        order = max(
            n
            for n in range(1, self.symmetry + 1)
            if self.symmetry % n == 0 and rotations % n == 0
        )
        count = rotations // order * times
        return np.arange(count) * (2 * np.pi / order / count)

    def turned(self, angle: float) -> np.ndarray:
        """Returns the (n, 3) vertices turned by ``angle`` about the axis."""
        c, s = np.cos(angle), np.sin(angle)
        turned = self.vertices.copy()
        turned[:, :2] = self.vertices[:, :2] @ np.array([[c, s], [-s, c]])
        return turned

    def reach(self, camera: PinholeCamera, floor: Floor) -> int:
        """Returns how far it reaches from its axis in an image, pixels."""
        places = np.concatenate([floor.corners(), [[0.0, 0.0]]])
        axis = np.pad(places, ((0, 0), (0, 1)), constant_values=self.middle)
        ring = np.linspace(0, 2 * np.pi, 17)[:-1]
        around = self.radius / np.cos(np.pi / 16) * np.exp(1j * ring)
        points = np.concatenate(
            [
                np.column_stack(
                    [around.real, around.imag, np.full(16, z - self.middle)]
                )
                for z in (0.0, self.height)
            ]
        )
        seen = camera.project(axis[:, None] + points)[..., :2]
        off = np.abs(seen - camera.project(axis)[:, None, :2])
        return int(np.ceil(off.max())) + 1

    def block_side(self, camera: PinholeCamera, times: int = 1) -> int:
        """Returns how large blocks of candidates may be, pixels.

        A body that is moved by d pixels, seen at half its height, shows its
        top moved by d·(c − h/2)/(c − h), c being the camera's height.

        Args:
            camera: the camera.
            times: so many times as large, for a first look.
        """
        above = float(camera.X_WC[2, 3]) - self.height
        most = 2 * _DRIFT * above / self.middle
        return int(np.clip(most, 1, _LARGEST_BLOCK)) * times

    def room(
        self, turned: np.ndarray, floor: Floor, slack: float
    ) -> np.ndarray:
        """Returns (4,) bounds x low, x high, y low, y high of its axis, m.

        Within them it keeps inside the bin's walls.

        Args:
            turned: (n, 3) points, m: what :meth:`turned` gave.
            floor: inside of the bin.
            slack: how far it may reach beyond, m.
        """
        low, high = turned[:, :2].min(axis=0), turned[:, :2].max(axis=0)
        return np.array(
            [
                floor.x[0] - slack - low[0],
                floor.x[1] + slack - high[0],
                floor.y[0] - slack - low[1],
                floor.y[1] + slack - high[1],
            ]
        )

    def drawing(self, angle: float, view: View, reach: int) -> Drawing:
        """Returns what the loops draw it by.

        Args:
            angle: about the axis, rad.
            view: the camera.
            reach: half width of the drawing, pixels.
        """
        return Drawing(self.turned(angle), self.faces, reach, self.middle, view)

    def draw(
        self, angle: float, pixel: np.ndarray, view: View, reach: int
    ) -> np.ndarray:
        """Draws it where its axis is seen at a pixel.

        Args:
            angle: about the axis, rad.
            pixel: (2,) u, v of the axis at height ``middle``.
            view: the camera.
            reach: half width of the drawing, pixels.

        Returns:
            (2·reach + 1)² float32 height of what is seen of it, m, −1 beside
            it; ``pixel`` is in the middle.
        """
        canvas = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
        draw_body(
            self.drawing(angle, view, reach),
            np.asarray(pixel, dtype=float),
            canvas,
        )
        return canvas
