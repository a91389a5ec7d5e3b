"""The occupancy distribution of a target, one candidate at a time.

Slow and plain: each candidate's mesh is cast ray by ray in true perspective
and its depth compared with the scene's. Shares with the fast method only the
list of candidates and the stated rules.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.spatial import ConvexHull

from tests.nominal import BIN
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


class _Body:
    """One way in which the target lies, by ray casting."""

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        config: GeometricConfig,
        depth: np.ndarray,
        mask: np.ndarray,
        camera: PinholeCamera,
        *,
        walls: bool,
    ) -> None:
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
        ground = camera.unproject(camera.plane_depth(0.0))
        self.on_floor = self._within(ground)

    def _within(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) points to (...) bool: above the floor, or nearly."""
        (x_low, x_high), (y_low, y_high) = BIN.floor.x, BIN.floor.y
        slack = self.config.floor_tolerance
        low = np.array([x_low, y_low]) - slack
        high = np.array([x_high, y_high]) + slack
        xy = points[..., :2]
        return ((xy >= low) & (xy <= high)).all(axis=-1)

    def candidates(
        self, poses: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Casts each candidate that keeps within image and bin.

        Args:
            poses: (n, 3) x, y (m) and angle (rad).

        Yields:
            (k, 2) rows and columns of its amodal mask; (k,) bool, which of
            them would be visible.
        """
        center = self.camera.X_WC[:3, 3]
        tolerance = self.config.depth_tolerance
        size = np.array(self.camera.shape[::-1])
        for first in range(0, len(poses), 256):
            rows, columns, origins, rays, owner = [], [], [], [], []
            for i in range(first, min(first + 256, len(poses))):
                x, y, angle = poses[i]
                c, s = np.cos(angle), np.sin(angle)
                R_WO = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
                corners = self.mesh.vertices @ R_WO.T + [x, y, 0]
                uv = self.camera.project(corners)[:, :2]
                low, high = uv.min(axis=0), uv.max(axis=0)
                if (low < -0.5).any() or (high > size - 0.5).any():
                    continue
                if self.walls and not self._within(corners).all():
                    continue
                u0, v0 = np.floor(low).astype(int).clip(0)
                u1, v1 = np.minimum(np.ceil(high).astype(int) + 1, size)
                v, u = np.mgrid[v0:v1, u0:u1].reshape(2, -1)
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
                    yield np.stack([v[a:b], u[a:b]], axis=1), visible[a:b]

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

    def measure(
        self, poses: np.ndarray
    ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Returns amodal pixels, modal areas, and common ones with the mask.

        Of a hidden target, of the candidates alone that show next to nothing.
        """
        hidden = not self.mask.any()
        masks, shown, common = [], [], []
        for px, seen in self.candidates(self.worth_casting(poses)):
            modal = px[seen]
            if hidden and len(modal) > self.config.blank_tolerance * len(px):
                continue
            masks.append(px)
            shown.append(len(modal))
            common.append(np.count_nonzero(self.mask[modal[:, 0], modal[:, 1]]))
        return masks, np.array(shown, int), np.array(common, int)

    def shows_floor(self) -> np.ndarray:
        low = min(self.config.floor_height, self.mesh.extents[2] / 2)
        return self.reading & (self._height < low) & ~self.mask


def brute_force(
    meshes: Sequence[trimesh.Trimesh],
    poses: Sequence[np.ndarray],
    config: GeometricConfig,
    depth: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    *,
    probabilities: Sequence[float] = (1.0,),
    walls: bool = False,
) -> np.ndarray:
    """Returns the (H, W) distribution.

    Args:
        meshes: the target as it lies, in each way that counts.
        poses: (n, 3) candidates of each: x, y (m) and angle (rad).
        config: of the inference.
        depth: (H, W) m.
        mask: (H, W) bool, of what is seen of it.
        camera: of both.
        probabilities: of the ways to lie.
        walls: the body must keep inside the bin's walls, rather than its
            image on the floor.
    """
    bodies = [
        _Body(mesh, config, depth, mask, camera, walls=walls) for mesh in meshes
    ]
    found = [body.measure(own) for body, own in zip(bodies, poses, strict=True)]
    each = [
        p / len(np.unique(own[:, 2]))
        for p, own in zip(probabilities, poses, strict=True)
    ]
    masks = [px for own, _, _ in found for px in own]
    weights = np.repeat(each, [len(own) for own, _, _ in found])
    chosen = np.ones(len(masks), bool)
    if mask.any():
        sizes, shares = np.transpose(
            [
                (np.mean([len(px) for px in own]), p)
                for (own, _, _), p in zip(found, probabilities, strict=True)
                if own
            ]
        )
        chosen = _choose(
            config,
            np.count_nonzero(mask),
            np.concatenate([area for _, area, _ in found]),
            np.concatenate([cover for _, _, cover in found]),
            float(np.average(sizes, weights=shares)),
        )
    total = np.zeros(camera.shape)
    for i in np.flatnonzero(chosen):
        px = masks[i]
        total[px[:, 0], px[:, 1]] += weights[i]
    lowest = min(bodies, key=lambda body: body.mesh.extents[2])
    total[lowest.shows_floor()] = 0
    return total / max(total.max(), 1e-12)


def _choose(
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
