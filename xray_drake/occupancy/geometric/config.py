"""The numbers of geometric inference."""

from dataclasses import dataclass, field

from xray_drake.configuration import choice, count, number
from xray_drake.occupancy.label.config import LabelConfig

POSES = ("auto", "flat", "resting")


@dataclass
class GeometricLabelConfig:
    """Numbers of ``geometric_label``, chosen on validation objects."""

    # A pose shows the same as another where the two modal masks differ by no
    # more than this share of the observed one and this number of pixels. (The
    # label asks for an IoU above 0.9.)
    tolerance: float = number(0.09, "[0, 1]")
    pixels: float = number(0.5, "(0, 1000]")
    # The target's true pose differs from what is observed about as little as
    # the best one; less probable by e with each further difference of this
    # share of the mask and ``pixels``.
    spread: float = number(0.03, "(0, 1]")
    # If more poses than this show the same, some of the lattices that they
    # are on stand for all.
    most_poses: int = count(3000, "[1, 1000000]")
    # What a pixel costs that is said to be covered, where one that is rightly
    # said so counts 1.
    cost: float = number(0.8, "(0, 10]")
    # The answer is the best one if answers are off by about this. (A network
    # that learns them is off by more: ``training.teacher``.)
    slack: float = number(0.005, "(0, 1]")
    # Of a hidden target: maximum of the sum over all poses, where that over
    # poses 8 pixels apart, which is less even, is 1.
    peak: float = number(0.85, "(0, 10]")


@dataclass
class GeometricConfig:
    """Numbers of geometric inference."""

    # How the target can lie: "flat", body z axis up (``FlatPoses``); "resting",
    # on every face on which it does not topple (``RestingPoses``); or "auto",
    # flat where it lies so as a rule, else resting.
    poses: str = choice("auto", POSES)
    # "resting": ways to lie that are less probable than this are left out.
    least_share: float = number(0.03, "[0, 1)")
    # Orientations over the full turn; a silhouette that repeats itself within
    # the turn is searched once per distinct orientation.
    rotations: int = count(32, "[1, 3600]")
    # Where the target is seen, a fraction of a pixel counts: there, the least
    # multiple of that number for which no point of the target moves farther
    # than this from one orientation to the next, m.
    seen_step: float = number(0.003, "[0.0001, 0.1]")
    # Translations: pitch of the lattice on the floor, m. A pixel covers 1.25
    # to 1.7 mm of the floor.
    cell: float = number(0.00127, "[0.0002, 0.05]")
    # How far a candidate may reach beyond the floor, m.
    floor_tolerance: float = number(0.002, "[0, 0.1]")
    # A surface hides what is farther than it by more than this, m.
    depth_tolerance: float = number(0.0001, "[0, 0.1]")
    # A target that is not seen may show this share of its silhouette.
    blank_tolerance: float = number(0.02, "[0, 1)")
    # A candidate of a target that is seen reaches this share of the best IoU.
    accept_iou: float = number(0.9, "(0, 1]")
    # If the best IoU is lower, the target is tilted, and coverage decides.
    trusted_iou: float = number(0.75, "[0, 1]")
    # So it does if less than this share of the silhouette is seen.
    fragment_share: float = number(0.2, "[0, 1]")
    # Coverage: candidates cover this share of the best-covered part of the
    # observed mask, and of those, none
    accept_coverage: float = number(0.9, "(0, 1]")
    # shows beyond the mask more than the one that shows least does, plus this
    # share of its silhouette.
    accept_spill: float = number(0.1, "[0, 1]")
    # A surface lower than this (and than half the target's thickness) is the
    # floor, m: where it shows, the target is not.
    floor_height: float = number(0.002, "[0, 0.1]")
    # Numbers of "geometric_label", which guesses the paper's label.
    label: GeometricLabelConfig = field(default_factory=GeometricLabelConfig)


def check_label(config: GeometricConfig) -> None:
    """Refuses numbers that the label cannot be answered with.

    Args:
        config: for ``geometric_label`` inference.

    Raises:
        ValueError: the label's orientations are not among those that are
            searched.
    """
    turns = LabelConfig().rotations
    if config.rotations % turns:
        raise ValueError(
            f"geometric.rotations is {config.rotations}: the label has {turns} "
            'orientations, so "geometric_label" needs a multiple of that'
        )
