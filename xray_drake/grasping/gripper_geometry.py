"""What planning knows of a gripper's shape: its frames and its boxes."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    Box,
    Cylinder,
    GeometryId,
    SceneGraphInspector,
    Shape,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from xray_drake.cell.gripper import GripperSpec
from xray_drake.configuration import ConfigurationError
from xray_drake.messages import GraspKind
from xray_drake.scene.parsing import configure_parser

CUP = "cup"
"""Name of the frame at the cup's lip, and of the cup's collision geometry."""

_DIGITS = 9
"""Lengths are rounded to a nanometre."""

FINGER_JOINTS = ("left_finger_joint", "right_finger_joint")
"""Each from open (0) to closed."""


@dataclass(frozen=True, eq=False)
class GripperGeometry:
    """Frames and collision geometry of a gripper's model.

    Cylinders are represented by their bounding boxes, a finger and its pad by
    one box, and the cup goes on to its lip. All boxes are aligned
    with the axes of the base frame B.

    Attributes:
        X_BJ: 4×4 pose of the jaw frame in B, m.
        X_BC: 4×4 pose of the cup frame in B, m; None without a cup.
        lower: (n, 3) lower corners in B with the jaw open, m.
        upper: (n, 3) upper corners in B with the jaw open, m.
        closing: (n,) direction along y in which the box moves when the jaw
            closes: −1, 0 or 1.
        round: (n,) whether the box bounds a cylinder along the base's x axis.
    """

    X_BJ: np.ndarray
    X_BC: np.ndarray | None
    lower: np.ndarray
    upper: np.ndarray
    closing: np.ndarray
    round: np.ndarray

    @property
    def kinds(self) -> tuple[GraspKind, ...]:
        """What it can grasp with."""
        if self.X_BC is None:
            return (GraspKind.JAW,)
        return GraspKind.JAW, GraspKind.SUCTION

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
        """Returns the 4×4 pose X_BG of the frame that grasps, m.

        Raises:
            ValueError: suction, and there is no cup.
        """
        if kind is not GraspKind.SUCTION:
            return self.X_BJ
        if self.X_BC is None:
            raise ValueError("the gripper has no suction cup")
        return self.X_BC

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
        end = [self.frame(kind)[0, 3] - standoff, np.inf, np.inf]
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


def gripper_geometry(spec: GripperSpec) -> GripperGeometry:
    """Returns the geometry of a gripper's model.

    Raises:
        ConfigurationError: as :func:`load_gripper_geometry`; or the model is
            not of that gripper: it opens less, or has no cup.
    """
    geometry = load_gripper_geometry(spec.file)
    if spec.opening > geometry.open_width + 1e-9:
        raise ConfigurationError(
            f"opening is {spec.opening:g}, but {spec.file} opens to "
            f"{geometry.open_width:g} m"
        )
    if spec.has_cup and geometry.X_BC is None:
        raise ConfigurationError(
            f"cup_radius is {spec.cup_radius:g}, but {spec.file} has no frame "
            f"{CUP!r}"
        )
    return geometry if spec.has_cup else replace(geometry, X_BC=None)


@cache
def load_gripper_geometry(path: Path) -> GripperGeometry:
    """Reads frames and collision geometry from a gripper's SDFormat file.

    Args:
        path: of the file.

    Raises:
        ConfigurationError: the file cannot be parsed, or lacks a frame, a body
            or a joint; a collision geometry that is neither box nor cylinder,
            or that is not aligned with the base frame.
    """
    try:
        return _read_geometry(path)
    except (RuntimeError, ValueError) as error:
        said = " ".join(str(error).split())
        raise ConfigurationError(f"{path}: {said}") from error


def _read_geometry(path: Path) -> GripperGeometry:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    configure_parser(parser)
    (model,) = parser.AddModels(path)
    base = plant.GetBodyByName("gripper_base", model)
    plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    context = plant.CreateDefaultContext()

    def frame(name: str) -> np.ndarray:
        frame = plant.GetFrameByName(name, model)
        return frame.CalcPoseInBodyFrame(context).GetAsMatrix4()

    X_BC = frame(CUP) if plant.HasFrameNamed(CUP, model) else None
    if X_BC is not None and not np.allclose(X_BC[:3, 2], [1, 0, 0]):
        raise ValueError(f"frame {CUP!r} does not look along gripper_base's x")

    closing_of = {}
    for name in FINGER_JOINTS:
        joint = plant.GetJointByName(name, model)
        closing_of[joint.child_body().name()] = float(
            np.sign(joint.translation_axis()[1])
        )

    inspector: SceneGraphInspector = scene_graph.model_inspector()
    lower, upper, closing, round_ = [], [], [], []
    for index in plant.GetBodyIndices(model):
        body = plant.get_body(index)
        X_BL = body.EvalPoseInWorld(context).GetAsMatrix4()
        own = [
            _box(inspector, geometry, X_BL, X_BC)
            for geometry in plant.GetCollisionGeometriesForBody(body)
        ]
        if body.name() in closing_of and own:
            # Finger and pad are one.
            lows, highs, _ = zip(*own, strict=True)
            own = [(np.min(lows, axis=0), np.max(highs, axis=0), False)]
        for low, high, is_round in own:
            # As a file would have one box.
            center = np.round(0.5 * (low + high), _DIGITS)
            half = np.round(0.5 * (high - low), _DIGITS)
            lower.append(center - half)
            upper.append(center + half)
            round_.append(is_round)
            closing.append(closing_of.get(body.name(), 0.0))
    return GripperGeometry(
        X_BJ=frame("jaw"),
        X_BC=X_BC,
        lower=np.array(lower),
        upper=np.array(upper),
        closing=np.array(closing),
        round=np.array(round_),
    )


def _box(
    inspector: SceneGraphInspector,
    geometry: GeometryId,
    X_BL: np.ndarray,
    X_BC: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Returns corners of a geometry, and whether it is round along x.

    The cup's bellows, which does not collide, is part of the cup.

    Args:
        inspector: knows it.
        geometry: of a body L.
        X_BL: 4×4 pose of the body, m.
        X_BC: 4×4 pose of the cup frame, if there is one, m.
    """
    name = inspector.GetName(geometry).split("::")[-1]
    X_BS = X_BL @ inspector.GetPoseInFrame(geometry).GetAsMatrix4()
    shape = inspector.GetShape(geometry)
    half = _half_size(shape)
    R = np.abs(X_BS[:3, :3])
    if not np.allclose(R, np.round(R), atol=1e-6):
        raise ValueError(f"{name} is not aligned with gripper_base")
    extent = np.round(R) @ half
    low, high = X_BS[:3, 3] - extent, X_BS[:3, 3] + extent
    if X_BC is not None and name == CUP:
        high[0] = X_BC[0, 3]
    is_round = isinstance(shape, Cylinder) and R[0, 2] > 0.5
    return low, high, is_round
