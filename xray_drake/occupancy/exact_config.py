"""The numbers of exact inference."""

from dataclasses import dataclass, field

POSES = ("flat", "resting")


@dataclass
class ExpectedLabelConfig:
    """Numbers of ``ExpectedLabel``, chosen on validation objects."""

    # A pose shows the same as another where the two modal masks differ by no
    # more than this share of the observed one and this number of pixels. (The
    # label asks for an IoU above 0.9.)
    tolerance: float = 0.09
    pixels: float = 0.5
    # The target's true pose differs from what is observed about as little as
    # the best one; less probable by e with each further difference of this
    # share of the mask and ``pixels``.
    spread: float = 0.03
    # If more poses than this show the same, some of the lattices that they
    # are on stand for all.
    most_poses: int = 3000
    # What a pixel costs that is said to be covered, where one that is rightly
    # said so counts 1.
    cost: float = 0.8
    # The answer is the best one if answers are off by about this. (A network
    # that learns them is off by more: ``training.teacher``.)
    slack: float = 0.005
    # Of a hidden target: maximum of the sum over all poses, where that over
    # poses 8 pixels apart, which is less even, is 1.
    peak: float = 0.85


@dataclass
class ExactInferenceConfig:
    """Numbers of exact inference."""

    # How the target can lie: "flat", body z axis up (``ExactInference``), or
    # "resting", on every face on which it does not topple
    # (``RestingInference``).
    poses: str = "flat"
    # "resting": ways to lie that are less probable than this are left out.
    least_share: float = 0.03
    # Orientations over the full turn; a silhouette that repeats itself within
    # the turn is searched once per distinct orientation.
    rotations: int = 32
    # Where the target is seen, a fraction of a pixel counts: there, the least
    # multiple of that number for which no point of the target moves farther
    # than this from one orientation to the next, m.
    seen_step: float = 0.003
    # Translations: pitch of the lattice on the floor, m. A pixel covers 1.25
    # to 1.7 mm of the floor.
    cell: float = 0.00127
    # Inside of the bin floor: x low, x high, y low, y high, m.
    floor: list[float] = field(
        default_factory=lambda: [-0.25, 0.25, -0.20, 0.20]
    )
    # How far a candidate may reach beyond the floor, m.
    floor_tolerance: float = 0.002
    # A surface hides what is farther than it by more than this, m.
    depth_tolerance: float = 0.0001
    # A target that is not seen may show this share of its silhouette.
    blank_tolerance: float = 0.02
    # A candidate of a target that is seen reaches this share of the best IoU.
    accept_iou: float = 0.9
    # If the best IoU is lower, the target is tilted, and coverage decides.
    trusted_iou: float = 0.75
    # So it does if less than this share of the silhouette is seen.
    fragment_share: float = 0.2
    # Coverage: candidates cover this share of the best-covered part of the
    # observed mask, and of those, none
    accept_coverage: float = 0.9
    # shows beyond the mask more than the one that shows least does, plus this
    # share of its silhouette.
    accept_spill: float = 0.1
    # A surface lower than this (and than half the target's thickness) is the
    # floor, m: where it shows, the target is not.
    floor_height: float = 0.002
    # Numbers of "expected", which guesses the paper's label.
    label: ExpectedLabelConfig = field(default_factory=ExpectedLabelConfig)
