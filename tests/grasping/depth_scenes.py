"""Scenes of a few meshes on the bin's floor, and how a camera sees them."""

import trimesh

from tests.occupancy.brute_force import render
from tests.poses import at
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.evidence.depth_surface import observe
from xray_drake.scene.object_model import object_from_pieces


def block(extents, X_WO):
    return trimesh.creation.box(extents).apply_transform(X_WO)


def model_block(name, *extents, density=600.0):
    """A block whose model is known."""
    pieces = [trimesh.creation.box(extents)]
    return object_from_pieces(name, pieces, density=density)


def ball(radius, x, y, z):
    return trimesh.creation.icosphere(4, radius).apply_transform(at(x, y, z))


def rod(radius, length, X_WO):
    mesh = trimesh.creation.cylinder(radius, length, sections=64)
    return mesh.apply_transform(X_WO)


def turned(camera, X):
    """Returns a camera moved by a 4×4 pose."""
    return PinholeCamera(
        camera.width, camera.height, camera.intrinsics, X @ camera.X_WC
    )


def see(camera, *meshes):
    """Returns the depth image, and the mask of the first mesh."""
    depth, label = render(camera, list(meshes))
    return depth, label == 0


def surface_of(camera, *meshes):
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
