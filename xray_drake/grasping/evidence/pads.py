"""What a jaw's closing pads meet on a mesh."""

import numpy as np
import trimesh

from xray_drake.grasping.evidence.sampling import cast_rays
from xray_drake.grasping.judgement import GripperModel
from xray_drake.grasping.wrench import PadContact


def touch(
    mesh: trimesh.Trimesh,
    X_OG: np.ndarray,
    opening: float,
    gripper: GripperModel,
) -> tuple[tuple[PadContact, PadContact], float, float] | None:
    """Closes the pads until each touches the object.

    Args:
        mesh: of the object in its frame O, m.
        X_OG: 4×4 pose of the jaw.
        opening: distance of the pads before, m.
        gripper: whose pads they are.

    Returns:
        The contacts in O (the pad on the +y side first), the distance of
        the closed pads, m, and the touched share of the pad touched less;
        None if a pad finds nothing.
    """
    spec, tip = gripper.spec, gripper.geometry.tip_length
    x = (np.arange(3) - 1) * spec.pad_width / 3
    z = tip - spec.pad_height * (np.arange(6) + 0.5) / 6
    grid = [g.ravel() for g in np.meshgrid(x, z, indexing="ij")]
    contacts, travel, coverage = [], 0.0, 1.0
    for sign in (-1.0, 1.0):
        side = np.full(len(grid[0]), -sign * 0.5 * opening)
        origins = np.stack([grid[0], side, grid[1]], axis=-1)
        origins = origins @ X_OG[:3, :3].T + X_OG[:3, 3]
        directions = np.tile(sign * X_OG[:3, 1], (len(origins), 1))
        distance, face = cast_rays(mesh, origins, directions)
        distance[distance > opening] = np.inf
        if not np.isfinite(distance).any():
            return None
        touching = distance <= distance.min() + spec.pad_compliance
        along = distance[touching, None] * directions[touching]
        point = (origins[touching] + along).mean(axis=0)
        normal = -mesh.face_normals[face[touching]].mean(axis=0)
        area = spec.pad_width * spec.pad_height * touching.mean()
        contacts.append(
            PadContact(
                point=point,
                normal=normal / np.linalg.norm(normal),
                torsion_radius=2 / 3 * np.sqrt(area / np.pi),
            )
        )
        travel += float(distance.min())
        coverage = min(coverage, float(touching.mean()))
    width = max(0.0, opening - travel)
    return (contacts[0], contacts[1]), width, coverage
