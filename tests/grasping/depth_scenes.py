"""Scenes of a few meshes on the bin's floor, and how a camera sees them."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from tests.occupancy.brute_force import render
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.evidence.depth_surface import DepthSurface, observe


def at(x, y, z, roll=0.0, pitch=0.0, yaw=0.0):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    X[:3, 3] = x, y, z
    return X


def downwards(x, y, z, yaw=0.0):
    return at(x, y, z, roll=np.pi, yaw=yaw)


def block(extents, X_WO):
    return trimesh.creation.box(extents).apply_transform(X_WO)


def ball(radius, x, y, z):
    return trimesh.creation.icosphere(4, radius).apply_transform(at(x, y, z))


def rod(radius, length, X_WO):
    return trimesh.creation.cylinder(
        radius, length, sections=64
    ).apply_transform(X_WO)


def turned(camera, angle):
    """Returns a camera turned about the world's vertical."""
    return PinholeCamera(
        camera.width,
        camera.height,
        camera.intrinsics,
        at(0, 0, 0, yaw=angle) @ camera.X_WC,
    )


def see(camera, *meshes):
    """Returns the depth image, and the mask of the first mesh."""
    depth, label = render(camera, list(meshes))
    return depth, label == 0


def surface_of(camera, *meshes) -> DepthSurface:
    depth, mask = see(camera, *meshes)
    surface = observe(depth, mask, camera, min_pixels=10)
    assert surface is not None
    return surface


def clutter(rng, count, *, spread=0.06):
    """Returns blocks that lie about, some leaning, the first in the middle."""
    meshes = []
    for i in range(count):
        extents = rng.uniform(0.012, 0.05, 3)
        roll, pitch = rng.normal(scale=0.2, size=2)
        x, y = (0.0, 0.0) if i == 0 else rng.normal(scale=spread, size=2)
        mesh = block(extents, at(x, y, 0, roll, pitch, rng.uniform(0, 6)))
        mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
        meshes.append(mesh)
    return meshes
