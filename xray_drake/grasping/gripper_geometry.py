"""What planning knows of the gripper: its limits, its frames and its boxes."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from pydrake.geometry import Box, Cylinder, SceneGraphInspector, Shape
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from xray_drake.configuration import number
from xray_drake.messages import GraspKind
from xray_drake.resources import models_dir

FINGER_TRAVEL = 0.025
"""Travel of one finger joint from open (0) to closed, m (``gripper.sdf``)."""


@dataclass
class GripperParameters:
    """What the gripper can do.

    The defaults are those of the ABB YuMi smart gripper where it publishes
    them (opening, force; also Dex-Net's parameters of this gripper), of
    PROTOCOL.md (friction) and of Dex-Net 3.0 (cup radius). The rest is chosen,
    for the reasons given.
    """

    # Distance of the pads when open, m.
    opening: float = number(0.05, f"(0, {2 * FINGER_TRAVEL}]")
    # Largest normal force at each pad, N.
    force: float = number(20.0, "(0, 1000]")
    # Coulomb coefficient of pads and cup.
    friction: float = number(0.5, "(0, 5]")
    # Width and height of the pad at each fingertip, m (gripper.sdf).
    pad_width: float = number(0.010, "(0, 0.1]")
    pad_height: float = number(0.010, "(0, 0.1]")
    # How far the pad gives way, m: what is closer than this to the first point
    # of contact touches the pad too.
    pad_compliance: float = number(0.001, "[0, 0.1]")
    # Radius of the suction cup's lip, m.
    cup_radius: float = number(0.015, "(0, 0.1]")
    # Largest pull of the vacuum, N: 20 kPa below ambient over the cup's area,
    # π (15 mm)². Chosen: a small ejector on a bellows cup lifts about 1 kg.
    vacuum_force: float = number(14.0, "(0, 1000]")
    # Elastic constant κ of the lip in Dex-Net 3.0's model, N. V / 2π: the
    # moment πrκ = rV/2 is the one at which a lip with linearly varying
    # pressure, pressed by V in all, would begin to lift on one side.
    cup_elasticity: float = number(2.2, "(0, 1000]")
    # What the bellows takes up along its axis, either way, m.
    bellows_travel: float = number(0.004, "(0, 0.1]")


@dataclass(frozen=True, eq=False)
class GripperGeometry:
    """Frames and collision geometry of ``gripper.sdf``.

    Cylinders are represented by their bounding boxes. All boxes are aligned
    with the axes of the base frame B.

    Attributes:
        X_BJ: 4×4 pose of the jaw frame in B, m.
        X_BC: 4×4 pose of the cup frame in B, m.
        lower: (n, 3) lower corners in B with the jaw open, m.
        upper: (n, 3) upper corners in B with the jaw open, m.
        closing: (n,) direction along y in which the box moves when the jaw
            closes: −1, 0 or 1.
        round: (n,) whether the box bounds a cylinder along the base's x axis.
    """

    X_BJ: np.ndarray
    X_BC: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    closing: np.ndarray
    round: np.ndarray

    @property
    def tip_length(self) -> float:
        """How far the fingertips reach beyond the jaw's origin, m."""
        fingers = self.closing != 0
        return float(self.upper[fingers, 2].max() - self.X_BJ[2, 3])

    @property
    def open_width(self) -> float:
        """Distance of the pads when the jaw is open, m."""
        inner = np.where(self.closing < 0, self.lower[:, 1], -self.upper[:, 1])
        return float(2 * inner[self.closing != 0].min())

    def closing_shift(self, opening: np.ndarray | float) -> np.ndarray:
        """Returns (..., n, 3): how the boxes move from the open jaw, m.

        Args:
            opening: (...) distance of the pads, m.
        """
        travel = 0.5 * (self.open_width - np.asarray(opening))
        motion = np.outer(self.closing, [0.0, 1.0, 0.0])
        return travel[..., None, None] * motion

    def frame(self, kind: GraspKind) -> np.ndarray:
        """Returns the 4×4 pose X_BG of the frame that grasps, m."""
        return self.X_BC if kind is GraspKind.SUCTION else self.X_BJ

    def approach(
        self, kind: GraspKind, distance: float, standoff: float
    ) -> "GripperGeometry":
        """Returns the boxes swept along a straight approach.

        Of the open jaw along z; across it stem and cup are boxes. Of the
        gripper closed, which does not open, and the cup ahead along x.

        Args:
            kind: jaw or suction.
            distance: length of the approach, m.
            standoff: the cup is cut off this far before its lip, m.
        """
        if kind is GraspKind.JAW:
            return replace(
                self,
                lower=self.lower - [0.0, 0.0, distance],
                round=np.zeros_like(self.round),
            )
        shut = self.closing_shift(0.0)
        end = [self.X_BC[0, 3] - standoff, np.inf, np.inf]
        return replace(
            self,
            lower=self.lower + shut - [distance, 0.0, 0.0],
            upper=np.minimum(self.upper + shut, end),
            closing=np.zeros_like(self.closing),
        )


def _half_size(shape: Shape) -> np.ndarray:
    if isinstance(shape, Box):
        return 0.5 * np.array(shape.size())
    if isinstance(shape, Cylinder):
        return np.array([shape.radius(), shape.radius(), 0.5 * shape.length()])
    raise ValueError(
        f"collision geometry of the gripper must be boxes and cylinders, not "
        f"{type(shape).__name__}"
    )


@cache
def load_gripper_geometry(path: Path | None = None) -> GripperGeometry:
    """Reads frames and collision geometry from the gripper's SDFormat file.

    Args:
        path: of the file; by default the one of the package.

    Raises:
        ValueError: a collision geometry that is neither box nor cylinder, or
            that is not aligned with the base frame.
        RuntimeError: the file cannot be parsed, or lacks a frame or a joint.
    """
    path = path or models_dir() / "gripper" / "gripper.sdf"
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    (model,) = Parser(plant).AddModels(path)
    base = plant.GetBodyByName("gripper_base", model)
    plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    context = plant.CreateDefaultContext()

    closing_of = {}
    for name in ("left_finger_joint", "right_finger_joint"):
        joint = plant.GetJointByName(name, model)
        closing_of[joint.child_body().name()] = float(
            np.sign(joint.translation_axis()[1])
        )

    inspector: SceneGraphInspector = scene_graph.model_inspector()
    lower, upper, closing, round_ = [], [], [], []
    for index in plant.GetBodyIndices(model):
        body = plant.get_body(index)
        X_BL = body.EvalPoseInWorld(context).GetAsMatrix4()
        for geometry in plant.GetCollisionGeometriesForBody(body):
            X_LS = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            X_BS = X_BL @ X_LS
            shape = inspector.GetShape(geometry)
            half = _half_size(shape)
            R = np.abs(X_BS[:3, :3])
            if not np.allclose(R, np.round(R), atol=1e-6):
                raise ValueError(
                    f"{path}: {inspector.GetName(geometry)} is not aligned "
                    "with gripper_base"
                )
            extent = np.round(R) @ half
            lower.append(X_BS[:3, 3] - extent)
            upper.append(X_BS[:3, 3] + extent)
            round_.append(isinstance(shape, Cylinder) and R[0, 2] > 0.5)
            closing.append(closing_of.get(body.name(), 0.0))

    def frame(name: str) -> np.ndarray:
        frame = plant.GetFrameByName(name, model)
        return frame.CalcPoseInBodyFrame(context).GetAsMatrix4()

    return GripperGeometry(
        X_BJ=frame("jaw"),
        X_BC=frame("cup"),
        lower=np.array(lower),
        upper=np.array(upper),
        closing=np.array(closing),
        round=np.array(round_),
    )
