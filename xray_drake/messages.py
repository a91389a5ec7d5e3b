"""What flows over the ports of the diagram, beside Drake's own types.

All messages are immutable: Drake copies abstract values freely (an event copies
all abstract state), so each answers a deep copy with itself. "Nothing" is an
empty message, never ``None``: ``None`` cannot cross a port.
"""

from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np


class Message:
    """Base of all messages; immutable, so a copy is the message itself."""

    def __copy__(self) -> "Message":
        return self

    def __deepcopy__(self, memo: dict) -> "Message":
        return self


def freeze_arrays(message: Message, **kinds: type) -> None:
    """Has a message keep read-only arrays of its own.

    Args:
        message: just made.
        **kinds: name of the attribute to the type of its numbers.
    """
    for name, kind in kinds.items():
        array: np.ndarray = np.array(getattr(message, name), dtype=kind)
        array.setflags(write=False)
        object.__setattr__(message, name, array)


@dataclass(frozen=True, eq=False)
class TargetMask(Message):
    """The target's modal mask as detected; blank where it is not seen.

    Attributes:
        data: (H, W) bool.
    """

    data: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))

    def __post_init__(self) -> None:
        freeze_arrays(self, data=bool)


@dataclass(frozen=True, eq=False)
class InstanceMasks(Message):
    """Modal masks of all objects seen, the target included where it is seen.

    Attributes:
        labels: (H, W) int32; −1 for the background, else an index into
            ``names``.
        names: what each label is called. Ground truth gives the object's name
            in the plant, other segmenters ``segment_0``, ``segment_1``, …,
            names that mean nothing in the next image.
    """

    labels: np.ndarray = field(
        default_factory=lambda: np.zeros((0, 0), np.int32)
    )
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self, labels=np.int32)

    def areas(self) -> np.ndarray:
        """Returns the (len(names),) visible pixels of each object."""
        flat = self.labels[self.labels >= 0]
        return np.bincount(flat, minlength=len(self.names))

    def mask(self, name: str) -> np.ndarray:
        """Returns the (H, W) bool mask of one object.

        Raises:
            ValueError: it is not among ``names``.
        """
        if name not in self.names:
            raise ValueError(f"no instance {name!r}: {', '.join(self.names)}")
        return self.labels == self.names.index(name)


@dataclass(frozen=True, eq=False)
class OccupancyDistribution(Message):
    """Where the target can be (paper section III.B: ρ).

    Attributes:
        data: (H, W) float32 in [0, 1]. Of labels and exact inference the
            maximum is 1, or all is 0; a network's answer is as it comes.
        support_threshold: values above it are support. Whoever makes the
            distribution sets it; whoever uses it asks for its support.
        method: how it came about, for the record: ``"geometric"`` and the like.
    """

    data: np.ndarray = field(
        default_factory=lambda: np.zeros((0, 0), np.float32)
    )
    support_threshold: float = 0.0
    method: str = "none"

    def __post_init__(self) -> None:
        freeze_arrays(self, data=np.float32)

    def support(self) -> np.ndarray:
        """Returns the (H, W) bool support (paper section III.D)."""
        return self.data > self.support_threshold

    def supported(self) -> np.ndarray:
        """Returns the (H, W) float32 data, 0 outside the support."""
        return np.where(self.support(), self.data, np.float32(0))

    def support_size(self) -> int:
        """Returns the number of pixels of the support."""
        return int(np.count_nonzero(self.support()))

    def support_01_size(self) -> int:
        """Returns the number of pixels with ρ > 0.1.

        It is recorded beside the support, since it is the same count for all
        methods.
        """
        return int(np.count_nonzero(self.data > 0.1))


class GraspKind(Enum):
    """How an object is held."""

    NONE = "none"
    JAW = "jaw"
    SUCTION = "suction"


@dataclass(frozen=True, eq=False)
class Grasp(Message):
    """A grasp on one object, planned at one state of the heap.

    Attributes:
        kind: jaw or suction; NONE for "no grasp".
        object: name of the object grasped.
        X_WG: 4×4 pose of the grasp frame in the world. Origin at the tool
            centre point (between the finger pads; at the cup's lip), z along
            the approach, y along the closing direction of the jaws.
        X_OG: 4×4 the same pose in the object's body frame: what makes two
            grasps "the same grasp" after the object has moved.
        width: distance of the two jaw contacts, m; 0 for suction.
        quality: in [0, 1]; 0 cannot hold, more is better.
    """

    kind: GraspKind = GraspKind.NONE
    object: str = ""
    X_WG: np.ndarray = field(default_factory=lambda: np.eye(4))
    X_OG: np.ndarray = field(default_factory=lambda: np.eye(4))
    width: float = 0.0
    quality: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self, X_WG=float, X_OG=float)

    def __bool__(self) -> bool:
        return self.kind is not GraspKind.NONE


class Rejection(NamedTuple):
    """Why some candidates for a grasp were not taken.

    Attributes:
        kind: of the grasps.
        reason: in a few words: "too wide", "jaw hits mug_003".
        candidates: how many of them.
    """

    kind: GraspKind
    reason: str
    candidates: int


@dataclass(frozen=True, eq=False)
class GraspPlan(Message):
    """What planning a grasp on one object came to.

    Attributes:
        grasp: the best; of kind NONE where there is none.
        rejections: of the candidates that failed; of each kind, the reasons
            that the most candidates have are first.
    """

    grasp: Grasp = field(default_factory=Grasp)
    rejections: tuple[Rejection, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.grasp)

    def why_not(self, most: int = 3) -> str:
        """Returns in one line why candidates failed.

        Args:
            most: so many reasons are told of each kind, the commonest.
        """
        parts = []
        for kind in (GraspKind.JAW, GraspKind.SUCTION):
            those = [r for r in self.rejections if r.kind is kind]
            told = [f"{r.candidates} × {r.reason}" for r in those[:most]]
            others = sum(r.candidates for r in those[most:])
            told += [f"{others} × otherwise"] if others else []
            if told:
                parts.append(f"{kind.value}: {', '.join(told)}")
        return "; ".join(parts)


class RankedCandidate(NamedTuple):
    """A candidate in its place in a ranking.

    Attributes:
        name: of the instance.
        score: the ranking's, in a unit of its own.
        hides: see :class:`xray_drake.policy.ranking.Scores`.
        passed_over: why another was grasped; empty for the one grasped, and
            for those after it that there was no need to look at.
    """

    name: str
    score: float
    hides: bool
    passed_over: str = ""


@dataclass(frozen=True, eq=False)
class SearchAction(Message):
    """What the policy decided, with what it knew.

    Attributes:
        number: 1, 2, …; 0 before the first decision. A new number is a new
            command to the gripper.
        grasp: what to do; its kind is NONE where no candidate has a grasp.
        is_target: the grasp is on the target.
        ranking: candidates in the order of preference, and why some were
            passed over.
        score: of the object grasped.
        support: |supp ρ| when it decided, pixels.
        support_01: number of pixels with ρ > 0.1 when it decided.
        target_pixels: visible pixels of the target when it decided.
        seconds: wall time of each stage.
        invalid: an agent chose what cannot be grasped, though others can.
    """

    number: int = 0
    grasp: Grasp = field(default_factory=Grasp)
    is_target: bool = False
    ranking: tuple[RankedCandidate, ...] = ()
    score: float = 0.0
    support: int = 0
    support_01: int = 0
    target_pixels: int = 0
    seconds: tuple[tuple[str, float], ...] = ()
    invalid: bool = False

    @property
    def why_no_grasp(self) -> str:
        """Why there is none, where ``grasp`` is of kind NONE."""
        if self.invalid:
            return "the choice has no grasp, others have"
        return "no candidate has a grasp"


@dataclass(frozen=True, eq=False)
class Choice(Message):
    """What an agent wants to be grasped next.

    Attributes:
        number: of the action that it is for: 1, 2, …; 0 is no choice.
        object: name of the instance; empty for none of them.
    """

    number: int = 0
    object: str = ""


@dataclass(frozen=True, eq=False)
class GraspOptions(Message):
    """What a policy can have grasped, whatever its ranking.

    Attributes:
        candidates: names of the objects seen well enough.
        qualities: of the best grasp on each; 0 where there is none.
        valid: the candidates that some ranking would have grasped.
    """

    candidates: tuple[str, ...] = ()
    qualities: tuple[float, ...] = ()
    valid: tuple[str, ...] = ()


class GripperMode(Enum):
    """What the gripper is doing."""

    IDLE = "idle"
    BUSY = "busy"


class Outcome(Enum):
    """How an action ended; the values are those of the rollout record."""

    NONE = "none"
    LIFTED = "lifted"
    FAILED = "failed"
    SLIPPED = "slipped"
    NO_GRASP = "no_grasp"


@dataclass(frozen=True, eq=False)
class GripperStatus(Message):
    """What the gripper tells the policy and the monitor.

    Attributes:
        mode: idle (at rest, so is the heap) or busy.
        number: number of the last action taken up.
        outcome: of that action; NONE while busy.
        reason: why it failed, one line; empty where it did not.
        held: name of the object in the gripper, empty where none is.
        stirring: objects in the bin may move; where it is False, only the
            objects in ``loose`` do.
        settling: while stirring: nothing is drawn any more, the gripper waits
            until the bin is at rest.
        loose: names of objects that move outside the bin.
    """

    mode: GripperMode = GripperMode.IDLE
    number: int = 0
    outcome: Outcome = Outcome.NONE
    reason: str = ""
    held: str = ""
    stirring: bool = False
    settling: bool = False
    loose: tuple[str, ...] = ()

    def has_done(self, number: int) -> bool:
        """Says whether it is idle, and that action was the last."""
        return self.mode is GripperMode.IDLE and self.number == number
