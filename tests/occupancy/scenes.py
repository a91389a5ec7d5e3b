"""Synthetic scenes: a flat target under boxes and spheres."""

import numpy as np
import trimesh

from xray_drake.geometry.camera import PinholeCamera


def make_camera(
    *,
    radius: float = 0.8,
    tilt: float = 0.0,
    azimuth: float = 0.0,
    roll: float = 0.0,
    focal_length: float = 552.5,
    center: tuple[float, float] = (255.5, 191.5),
    size: tuple[int, int] = (512, 384),
) -> PinholeCamera:
    """Makes a camera that looks at the world's origin (angles in degrees)."""
    tilt, azimuth, roll = np.deg2rad([tilt, azimuth, roll])
    up = np.array(
        [
            np.sin(tilt) * np.cos(azimuth),
            np.sin(tilt) * np.sin(azimuth),
            np.cos(tilt),
        ]
    )
    right = np.array([1.0, 0, 0]) - up[0] * up
    right /= np.linalg.norm(right)
    down = np.cross(-up, right)
    X_WC = np.eye(4)
    X_WC[:3, 0] = np.cos(roll) * right + np.sin(roll) * down
    X_WC[:3, 1] = np.cos(roll) * down - np.sin(roll) * right
    X_WC[:3, 2] = -up
    X_WC[:3, 3] = radius * up
    K = np.diag([focal_length, focal_length, 1.0])
    K[:2, 2] = center
    return PinholeCamera(*size, K, X_WC)


CAMERAS = {
    "nominal": make_camera(),
    "tilted": make_camera(tilt=10, azimuth=57),
    "rolled": make_camera(roll=10),
    "low": make_camera(
        radius=0.7,
        tilt=6,
        azimuth=230,
        roll=-6,
        focal_length=560,
        center=(258, 189),
    ),
    "high": make_camera(radius=0.9, focal_length=535),
}


def lying(
    mesh: trimesh.Trimesh, x: float, y: float, angle: float
) -> trimesh.Trimesh:
    """Lays a mesh, body z up, on the floor (m, rad)."""
    X_WO = trimesh.transformations.rotation_matrix(angle, [0, 0, 1])
    X_WO[:3, 3] = [x, y, -mesh.bounds[0, 2]]
    return mesh.copy().apply_transform(X_WO)


def occluders(
    rng: np.random.Generator,
    count: int,
    center: np.ndarray,
    spread: float,
    clearance: float,
) -> list[trimesh.Trimesh]:
    """Drops boxes and spheres around a place, held over the target.

    Args:
        rng: source of randomness.
        count: how many.
        center: (2,) m.
        spread: standard deviation, m.
        clearance: height of their lowest points, m.
    """
    meshes = []
    for _ in range(count):
        if rng.random() < 0.6:
            mesh = trimesh.creation.box(rng.uniform(0.02, 0.06, 3))
            mesh.apply_transform(
                trimesh.transformations.random_rotation_matrix(rng.random(3))
            )
        else:
            mesh = trimesh.creation.icosphere(3, rng.uniform(0.012, 0.03))
        x, y = rng.normal(center, spread)
        mesh.apply_translation([x, y, clearance - mesh.bounds[0, 2]])
        meshes.append(mesh)
    return meshes


def cover(
    mesh: trimesh.Trimesh,
    x: float,
    y: float,
    angle: float,
    margin: float = 0.03,
) -> trimesh.Trimesh:
    """Puts a plate right over a mesh that lies there, a little larger.

    Args:
        mesh: what is covered.
        x: of its middle, m.
        y: likewise.
        angle: of both, rad.
        margin: length of the plate beyond the mesh's, m; its width has 4 mm
            less of it.
    """
    length, width, height = mesh.extents
    sides = [length + margin, width + margin - 0.004, 0.01]
    plate = trimesh.creation.box(sides)
    X_WO = trimesh.transformations.rotation_matrix(angle, [0, 0, 1])
    X_WO[:3, 3] = [x, y, height + 0.006]
    return plate.apply_transform(X_WO)
