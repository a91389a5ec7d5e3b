"""Which body of the plant is under a grasp that was planned on an image.

Ground truth: for the record, and for the ideal gripper, which lifts bodies.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I

from xray_drake.cell.gripper import GripperSpec, load_gripper
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import Grasp, GraspKind, SearchAction

_SLACK = 0.003
"""Added to all sides of the space that a grasp closes on, m."""


def body_under_grasp(
    grasp: Grasp,
    labels: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    names: Mapping[str, int],
    gripper: GripperSpec,
) -> str:
    """Returns the object most of which is seen where a grasp closes.

    For the jaw that is between the pads, from the fingertips upwards; for the
    cup, under the lip.

    Args:
        grasp: planned on the heap that is seen.
        labels: (H, W) integer label image.
        depth: (H, W) z-depth as it truly is, m.
        camera: of both images.
        names: object to its value in the label image.
        gripper: that grasps.

    Returns:
        Its name; empty where no object is seen there.
    """
    if not grasp:
        return ""
    R, p = grasp.X_WG[:3, :3], grasp.X_WG[:3, 3]
    read = np.isfinite(depth)
    points = camera.unproject(np.where(read, depth, 0.0))
    x, y, z = np.moveaxis((points - p) @ R, -1, 0)
    if grasp.kind is GraspKind.JAW:
        there = (
            read
            & (np.abs(x) <= 0.5 * gripper.pad_width + _SLACK)
            & (np.abs(y) <= 0.5 * grasp.width + _SLACK)
            & (z <= 0.5 * gripper.pad_height)
        )
    else:
        there = (
            read
            & (np.hypot(x, y) <= gripper.cup_radius)
            & (np.abs(z) <= gripper.bellows_travel + _SLACK)
        )
    counts = {
        name: int(np.count_nonzero(there & (labels == label)))
        for name, label in names.items()
    }
    best = max(counts, key=lambda name: counts[name], default="")
    return best if best and counts[best] else ""


class GraspedBody(CollectableLeafSystem):
    """Tells a gripper that lifts bodies which body a grasp is on.

    .. pydrake_system::

        name: GraspedBody
        input_ports:
        - action
        - label_image
        - depth_image
        - camera
        - body_poses
        output_ports:
        - action

    A grasp planned on an image names a segment. ``action``
    (:class:`~xray_drake.messages.SearchAction`) goes out with the grasp on the
    body under it, by its name and in its frame; where none is, the name is
    empty. ``label_image`` (ImageLabel16I), ``depth_image`` (ImageDepth32F,
    without noise) and ``body_poses`` are the ground truth, ``camera`` is a
    PinholeCamera.

    It says so of the heap that is seen now: look before the gripper moves.
    """

    def __init__(
        self,
        *,
        bodies: Mapping[str, int],
        gripper: GripperSpec | None = None,
        width: int = 512,
        height: int = 384,
    ) -> None:
        """Declares the ports.

        Args:
            bodies: object name to its index in ``body_poses``, which is its
                value in the label image.
            gripper: that grasps; by default the nominal cell's.
            width: of the images, pixels.
            height: of the images, pixels.
        """
        super().__init__()
        self.set_name("grasped_body")
        self._bodies = dict(bodies)
        self._gripper = gripper or load_gripper()
        self._action = self.declare_input("action", SearchAction())
        self._label_image = self.declare_input(
            "label_image", ImageLabel16I(width, height)
        )
        self._depth_image = self.declare_input(
            "depth_image", ImageDepth32F(width, height)
        )
        self._camera = self.declare_input(
            "camera", PinholeCamera(width, height, np.eye(3), np.eye(4))
        )
        self._poses = self.declare_input("body_poses", [RigidTransform()])
        self.declare_output("action", SearchAction(), self._grounded)

    def _grounded(self, context: Context) -> SearchAction:
        action: SearchAction = self._action.Eval(context)
        if not action.grasp:
            return action
        return replace(action, grasp=self._on_body(context, action.grasp))

    def _on_body(self, context: Context, grasp: Grasp) -> Grasp:
        name = body_under_grasp(
            grasp,
            self._label_image.Eval(context).data[:, :, 0],
            self._depth_image.Eval(context).data[:, :, 0].astype(float),
            self._camera.Eval(context),
            self._bodies,
            self._gripper,
        )
        if not name:
            return replace(grasp, object="")
        X_WO = self._poses.Eval(context)[self._bodies[name]].GetAsMatrix4()
        X_OG = np.linalg.inv(X_WO) @ grasp.X_WG
        return replace(grasp, object=name, X_OG=X_OG)
