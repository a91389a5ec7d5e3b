"""The TrueTargetMask system alone: fix its inputs, read its output."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from tests.alone import Alone
from tests.occupancy.scenes import CAMERAS
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.policy.true_target import TrueTargetMask
from xray_drake.scene.targets import target_model


def test_it_draws_the_target_where_it_truly_is() -> None:
    target, camera = target_model("box_2to1"), CAMERAS["tilted"]
    X_WT = RigidTransform(RollPitchYaw(0.2, 0.1, 0.7), [0.03, -0.05, 0.02])
    poses = [RigidTransform([0.1 * i, 0, 0.1]) for i in range(4)]
    poses[2] = X_WT
    system = TrueTargetMask(target=target, body=2)
    mask = Alone(system, body_poses=poses, camera=camera).output("target_mask")
    mesh = target.visual
    expected = project_mesh_mask(
        mesh.vertices, mesh.faces, X_WT.GetAsMatrix4(), camera
    )
    np.testing.assert_array_equal(mask.data, expected)
    u, v, _ = camera.project(X_WT.translation())
    assert mask.data[round(v), round(u)]
