"""What a grasp planner asks, whatever the object is known by."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from xray_drake.grasping.candidates import Failures, GraspCandidates
from xray_drake.grasping.config import GraspPlannerConfig
from xray_drake.grasping.judgement import GripperModel
from xray_drake.grasping.seal import Seal
from xray_drake.messages import Grasp, GraspKind

Known = TypeVar("Known", contravariant=True)
"""What is known of a heap: poses of models, a depth image, …"""


@dataclass(frozen=True, eq=False)
class Approach:
    """Where a gripper comes to, and what is around it there.

    Attributes:
        X_WG: (n, 4, 4) poses at which it stops.
        space: (n,) free around it, m: −1 where it hits something, inf where it
            is free and nobody has measured how much.
        reason: (n,) str, what it hits; empty where it is free.
    """

    X_WG: np.ndarray
    space: np.ndarray
    reason: np.ndarray


@dataclass(frozen=True, eq=False)
class Squeeze:
    """What closing pads meet.

    Attributes:
        width: (n,) distance of the closed pads, m.
        angle: (n,) the larger of the two angles between the closing axis and
            the mean normal under a pad, rad.
        coverage: (n,) touched share of the pad touched less.
        holding: (n,) the largest weight that the contacts hold, N.
        reason: (n,) str, why they hold nothing, as where a pad misses the
            object; empty where they may.
    """

    width: np.ndarray
    angle: np.ndarray
    coverage: np.ndarray
    holding: np.ndarray
    reason: np.ndarray


class ObjectEvidence(Protocol):
    """What is known of one object in one heap.

    Attributes:
        X_OW: 4×4, the world in the object's frame; the identity where that
            frame is unknown.
        weight: of the object, N.
        center: (3,) its centre of mass in the world, m.
        friction: Coulomb coefficient between gripper and object.
        enough: so many grasps that hold end the search.
    """

    X_OW: np.ndarray
    weight: float
    center: np.ndarray
    friction: float
    enough: float

    def candidates(
        self, excluded: Sequence[Grasp], failures: Failures
    ) -> Iterator[GraspCandidates]:
        """Yields candidates that may be free, in batches to be judged.

        The best come first, as cheap estimates say; not more of them than are
        to be judged at most.

        Args:
            excluded: grasps that need not be judged again.
            failures: those dropped are counted here.
        """

    def excludes(
        self, excluded: Sequence[Grasp], kind: GraspKind, X_WG: np.ndarray
    ) -> bool:
        """Says whether a 4×4 pose in the world is an excluded grasp again."""

    def preference(self, X_WG: np.ndarray) -> np.ndarray:
        """Returns (n,) keys of (n, 4, 4) poses.

        Of grasps of equal quality the one with the lowest is the best, and of
        those the one found first.
        """

    def stop_jaw(
        self, X_WG: np.ndarray, opening: np.ndarray, overtravel: float
    ) -> Approach:
        """Lets the jaw come until it would touch something.

        Args:
            X_WG: (n, 4, 4) poses of the jaw.
            opening: (n,) distances of the pads, m.
            overtravel: how far beyond X_WG the jaw is commanded, m.
        """

    def close_pads(
        self, X_WG: np.ndarray, opening: np.ndarray, friction: np.ndarray
    ) -> Squeeze:
        """Closes the jaw's pads until each touches the object.

        Args:
            X_WG: (n, 4, 4) poses where the jaw has stopped.
            opening: (n,) distances of the pads, m.
            friction: (n,) Coulomb coefficients.
        """

    def lay_cup(self, X_WG: np.ndarray) -> Seal:
        """Says how cups at (n, 4, 4) poses meet the object, in the world."""

    def cup_space(self, X_WG: np.ndarray) -> Approach:
        """Says what the suction tool meets on its way to (n, 4, 4) poses."""


class GraspEvidence(Protocol[Known]):
    """Where a grasp planner has from what it knows of objects.

    Attributes:
        gripper: that is to grasp.
        config: how grasps are looked for.
        seed: of all that is drawn.
        exhaustive: judging many at once is cheap: all candidates are judged and
            all finalists rehearsed, which are distinct. Else both end as soon
            as enough have been found, or no better one can come.
    """

    gripper: GripperModel
    seed: int
    exhaustive: bool

    @property
    def config(self) -> GraspPlannerConfig:
        """How grasps are looked for."""

    def look(self, object_name: str, known: Known) -> ObjectEvidence | None:
        """Returns what is known of an object; None where that is too little.

        Args:
            object_name: of the object.
            known: of the heap.
        """
