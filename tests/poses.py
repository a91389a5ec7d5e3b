"""Poses, for tests."""

import numpy as np
from scipy.spatial.transform import Rotation


def at(x=0.0, y=0.0, z=0.0, roll=0.0, pitch=0.0, yaw=0.0):
    """A 4×4 pose; turned about the world's x, then y, then z."""
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    X[:3, 3] = x, y, z
    return X


def downwards(x, y, z, yaw=0.0):
    """A pose whose z axis points down."""
    return at(x, y, z, yaw=yaw) @ np.diag([1.0, -1.0, -1.0, 1.0])
