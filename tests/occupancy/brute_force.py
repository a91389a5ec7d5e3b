"""The occupancy distribution of a flat target, one candidate at a time.

Slow and plain: each candidate's mesh is cast ray by ray in true perspective
and its depth compared with the scene's. Shares with the fast method only the
list of candidates and the stated rules.
"""

from collections.abc import Iterator

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.spatial import ConvexHull

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.geometric.config import GeometricConfig


class Caster:
    """Casts rays at one mesh."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._scene = EmbreeScene()
        triangles = np.ascontiguousarray(mesh.triangles, dtype=np.float32)
        TriangleMesh(self._scene, triangles)

    def depth(self, origins: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Returns (n,) multiples of each ray to its first hit, else inf."""
        length = np.linalg.norm(rays, axis=1)
        distance = self._scene.run(
            origins.astype(np.float32),
            (rays / length[:, None]).astype(np.float32),
            query="DISTANCE",
        )
        return np.where(distance < 1e3, distance / length, np.inf)


def render(
    camera: PinholeCamera, meshes: list[trimesh.Trimesh]
) -> tuple[np.ndarray, np.ndarray]:
    """Renders meshes on the plane z = 0.

    Returns:
        (H, W) float32 z-depth and (H, W) index of the mesh seen, −1 for the
        plane.
    """
    rays = camera.rays()
    depth = camera.plane_depth(0.0)
    label = np.full(camera.shape, -1)
    for index, mesh in enumerate(meshes):
        uv = camera.project(mesh.vertices)[:, :2]
        u_low, v_low = np.floor(uv.min(axis=0)).astype(int).clip(0)
        u_high, v_high = np.ceil(uv.max(axis=0)).astype(int).clip(-1) + 1
        box = slice(v_low, v_high), slice(u_low, u_high)
        ahead = rays[box].reshape(-1, 3)
        origins = np.tile(camera.X_WC[:3, 3], (len(ahead), 1))
        cast = Caster(mesh).depth(origins, ahead).reshape(rays[box].shape[:2])
        label[box][cast < depth[box]] = index
        depth[box] = np.minimum(depth[box], cast)
    return depth.astype(np.float32), label


class BruteForce:
    """The reference: every candidate by ray casting."""

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        config: GeometricConfig,
        depth: np.ndarray,
        mask: np.ndarray,
        camera: PinholeCamera,
        *,
        walls: bool = False,
    ) -> None:
        """Prepares the rays.

        Args:
            walls: the body must keep inside the bin's walls, rather than its
                image on the floor.
        """
        self.config = config
        self.walls = walls
        self.depth = depth.astype(float)
        self.mask = mask
        self.camera = camera
        self.mesh = mesh.copy()
        self.mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
        self.caster = Caster(self.mesh)
        self.rays = camera.rays()
        self.reading = np.isfinite(depth) & (depth > 0)
        surface = camera.unproject(np.where(self.reading, depth, 0.0))
        self._height = np.where(self.reading, surface[..., 2], -np.inf)
        x_low, x_high, y_low, y_high = config.floor
        slack = config.floor_tolerance
        ground = camera.unproject(camera.plane_depth(0.0))
        self.on_floor = (
            (ground[..., 0] >= x_low - slack)
            & (ground[..., 0] <= x_high + slack)
            & (ground[..., 1] >= y_low - slack)
            & (ground[..., 1] <= y_high + slack)
        )

    def candidates(
        self, poses: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Casts each candidate that keeps within image and bin.

        Args:
            poses: (n, 3) x, y (m) and angle (rad).

        Yields:
            index of the pose; (k, 2) rows and columns of its amodal mask; (k,)
            bool, which of them would be visible.
        """
        center = self.camera.X_WC[:3, 3]
        tolerance = self.config.depth_tolerance
        for first in range(0, len(poses), 256):
            rows, columns, origins, rays, owner = [], [], [], [], []
            for i in range(first, min(first + 256, len(poses))):
                x, y, angle = poses[i]
                c, s = np.cos(angle), np.sin(angle)
                R_WO = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
                corners = self.mesh.vertices @ R_WO.T + [x, y, 0]
                uv = self.camera.project(corners)[:, :2]
                low = np.floor(uv.min(axis=0)).astype(int)
                high = np.ceil(uv.max(axis=0)).astype(int)
                if (uv.min(axis=0) < -0.5).any() or (
                    uv.max(axis=0) > np.array(self.camera.shape[::-1]) - 0.5
                ).any():
                    continue
                if self.walls and not self._inside_walls(corners):
                    continue
                v, u = np.mgrid[
                    max(low[1], 0) : high[1] + 1, max(low[0], 0) : high[0] + 1
                ].reshape(2, -1)
                keep = (v < self.camera.height) & (u < self.camera.width)
                u, v = u[keep], v[keep]
                rows.append(v)
                columns.append(u)
                rays.append(self.rays[v, u] @ R_WO)
                origin = R_WO.T @ (center - [x, y, 0])
                origins.append(np.tile(origin, (len(u), 1)))
                owner.append(np.full(len(u), i))
            if not owner:
                continue
            v, u = np.concatenate(rows), np.concatenate(columns)
            i = np.concatenate(owner)
            cast = self.caster.depth(
                np.concatenate(origins), np.concatenate(rays)
            )
            hit = np.isfinite(cast)
            v, u, i, cast = v[hit], u[hit], i[hit], cast[hit]
            visible = (
                (self.depth[v, u] > cast - tolerance)
                | ~self.reading[v, u]
                | self.mask[v, u]
            )
            outside = ~self.on_floor[v, u] & (not self.walls)
            starts = np.flatnonzero(np.diff(i, prepend=-1))
            for a, b in zip(starts, [*starts[1:], len(i)], strict=True):
                if not outside[a:b].any():
                    yield (
                        int(i[a]),
                        np.stack([v[a:b], u[a:b]], axis=1),
                        visible[a:b],
                    )

    def _inside_walls(self, corners: np.ndarray) -> bool:
        x_low, x_high, y_low, y_high = self.config.floor
        slack = self.config.floor_tolerance
        low, high = corners.min(axis=0), corners.max(axis=0)
        return bool(
            low[0] >= x_low - slack
            and high[0] <= x_high + slack
            and low[1] >= y_low - slack
            and high[1] <= y_high + slack
        )

    def worth_casting(self, poses: np.ndarray) -> np.ndarray:
        """Drops poses that are far from acceptance, by samples of points.

        Looks at the pixels where points of the surface fall, few and then
        more. Poses are kept generously: with 25 %, then 15 % visible where
        2 % are allowed, and from 25 %, then 50 % of the best IoU or coverage
        where 90 % of it are needed.
        """
        for count, shown, share in ((60, 0.25, 0.25), (300, 0.15, 0.5)):
            poses = self._promising(poses, count, shown, share)
        return poses

    def _promising(
        self, poses: np.ndarray, count: int, most_shown: float, share: float
    ) -> np.ndarray:
        points = trimesh.sample.sample_surface(self.mesh, count, seed=0)[0]
        area = self._footprint()
        shown, common = np.zeros(len(poses)), np.zeros(len(poses))
        for angle in np.unique(poses[:, 2]):
            chosen = np.flatnonzero(poses[:, 2] == angle)
            c, s = np.cos(angle), np.sin(angle)
            turned = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            for part in np.array_split(chosen, len(chosen) // 2000 + 1):
                move = np.pad(poses[part, :2], ((0, 0), (0, 1)))
                p_W = turned[None] + move[:, None]
                pixels = np.rint(self.camera.project(p_W)[..., :2]).astype(int)
                u = pixels[..., 0].clip(0, self.camera.width - 1)
                v = pixels[..., 1].clip(0, self.camera.height - 1)
                height = self._height[v, u]
                seen = (height < p_W[..., 2] + 1e-3) | self.mask[v, u]
                shown[part] = seen.mean(axis=1) * area
                common[part] = self.mask[v, u].mean(axis=1) * area
        if not self.mask.any():
            return poses[shown <= most_shown * area]
        size = np.count_nonzero(self.mask)
        keep = common >= share * common.max()
        if size >= 1.2 * self.config.fragment_share * area:
            iou = common / (shown + size - common)
            keep &= iou >= share * iou.max()
        return poses[keep]

    def _footprint(self) -> float:
        """Returns the area of the silhouette in pixels, roughly."""
        floor = self.camera.plane_depth(0.0)
        pixel = np.median(floor) / self.camera.intrinsics[0, 0]
        return ConvexHull(self.mesh.vertices[:, :2]).volume / pixel**2

    def infer(self, poses: np.ndarray) -> np.ndarray:
        """Returns the (H, W) distribution over the candidates ``poses``."""
        total = np.zeros(self.camera.shape)
        poses = self.worth_casting(poses)
        if self.mask.any():
            accepted = self._accepted_seen(poses)
        else:
            allowed = self.config.blank_tolerance
            accepted = [
                px
                for _, px, seen in self.candidates(poses)
                if np.count_nonzero(seen) <= allowed * len(seen)
            ]
        for px in accepted:
            total[px[:, 0], px[:, 1]] += 1
        total[self._shows_floor()] = 0
        return total / max(total.max(), 1.0)

    def _accepted_seen(self, poses: np.ndarray) -> list[np.ndarray]:
        """Returns the amodal pixels of each candidate that is accepted."""
        masks, area, cover = self.measure(poses)
        typical = float(np.mean([len(px) for px in masks]))
        size = np.count_nonzero(self.mask)
        chosen = choose(self.config, size, area, cover, typical)
        return [masks[i] for i in np.flatnonzero(chosen)]

    def measure(
        self, poses: np.ndarray
    ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Returns amodal pixels, modal areas, and common ones with the mask."""
        masks, shown, common = [], [], []
        for _, px, seen in self.candidates(poses):
            modal = px[seen]
            masks.append(px)
            shown.append(len(modal))
            common.append(np.count_nonzero(self.mask[modal[:, 0], modal[:, 1]]))
        return masks, np.array(shown), np.array(common)

    def _shows_floor(self) -> np.ndarray:
        low = min(self.config.floor_height, self.mesh.extents[2] / 2)
        return self.reading & (self._height < low) & ~self.mask


def choose(
    config: GeometricConfig,
    size: int,
    area: np.ndarray,
    cover: np.ndarray,
    typical: float,
) -> np.ndarray:
    """Returns which candidates of a target that is seen are accepted."""
    iou = cover / (area + size - cover)
    if (
        iou.max() >= config.trusted_iou
        and size >= config.fragment_share * typical
    ):
        return iou >= config.accept_iou * iou.max()
    chosen = cover >= config.accept_coverage * cover.max()
    spill = area - cover
    least = spill[chosen].min()
    return chosen & (spill <= least + config.accept_spill * typical)


class RestingBruteForce:
    """The reference over several ways to lie, each a mesh that stands."""

    def __init__(
        self,
        meshes: list[trimesh.Trimesh],
        probabilities: list[float],
        config: GeometricConfig,
        depth: np.ndarray,
        mask: np.ndarray,
        camera: PinholeCamera,
    ) -> None:
        self.config = config
        self.mask = mask
        self.camera = camera
        self.probabilities = probabilities
        self.each = [
            BruteForce(mesh, config, depth, mask, camera, walls=True)
            for mesh in meshes
        ]
        lowest = min(meshes, key=lambda mesh: mesh.extents[2])
        self.lowest = self.each[meshes.index(lowest)]

    def infer(self, poses: list[np.ndarray]) -> np.ndarray:
        """Returns the (H, W) distribution over each mesh's (n, 3) poses."""
        total = np.zeros(self.camera.shape)
        weights = [
            p / len(np.unique(own[:, 2]))
            for p, own in zip(self.probabilities, poses, strict=True)
        ]
        kept = [
            one.worth_casting(own)
            for one, own in zip(self.each, poses, strict=True)
        ]
        if self.mask.any():
            found = [
                one.measure(own)
                for one, own in zip(self.each, kept, strict=True)
            ]
            chosen = choose(
                self.config,
                np.count_nonzero(self.mask),
                np.concatenate([area for _, area, _ in found]),
                np.concatenate([cover for _, _, cover in found]),
                float(
                    np.average(
                        [
                            np.mean([len(px) for px in masks])
                            for masks, _, _ in found
                            if masks
                        ],
                        weights=[
                            p
                            for p, (masks, _, _) in zip(
                                self.probabilities, found, strict=True
                            )
                            if masks
                        ],
                    )
                ),
            )
            masks = [px for each, _, _ in found for px in each]
            owner = np.repeat(range(len(found)), [len(m) for m, _, _ in found])
            for i in np.flatnonzero(chosen):
                px = masks[i]
                total[px[:, 0], px[:, 1]] += weights[owner[i]]
        else:
            allowed = self.config.blank_tolerance
            for one, own, weight in zip(self.each, kept, weights, strict=True):
                for _, px, seen in one.candidates(own):
                    if np.count_nonzero(seen) <= allowed * len(seen):
                        total[px[:, 0], px[:, 1]] += weight
        total[self.lowest._shows_floor()] = 0
        return total / max(total.max(), 1e-12)
