"""The LeafSystem that tells the oracle where the target is."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import TargetMask
from xray_drake.scene.object_model import ObjectModel


class TrueTargetMask(CollectableLeafSystem):
    """Draws the target's amodal mask at its true pose: ground truth.

    .. pydrake_system::

        name: TrueTargetMask
        input_ports:
        - body_poses
        - camera
        output_ports:
        - target_mask

    ``body_poses`` are those of the plant, ``camera`` is a PinholeCamera and
    ``target_mask`` a :class:`~xray_drake.messages.TargetMask`: where the target
    would be seen if nothing lay before it.
    """

    def __init__(self, *, target: ObjectModel, body: int) -> None:
        """Declares the ports.

        Args:
            target: the target.
            body: its index in ``body_poses``.
        """
        super().__init__()
        self.set_name("true_target")
        self._vertices = target.visual.vertices
        self._faces = target.visual.faces
        self._body = body
        self._poses = self.declare_input("body_poses", [RigidTransform()])
        self._camera = self.declare_input(
            "camera", PinholeCamera(1, 1, np.eye(3), np.eye(4))
        )
        self.declare_output("target_mask", TargetMask(), self._mask)

    def _mask(self, context: Context) -> TargetMask:
        X_WT = self._poses.Eval(context)[self._body].GetAsMatrix4()
        camera: PinholeCamera = self._camera.Eval(context)
        return TargetMask(
            project_mesh_mask(self._vertices, self._faces, X_WT, camera)
        )
