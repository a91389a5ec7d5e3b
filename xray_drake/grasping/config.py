"""How grasps are looked for, whatever the objects are known by."""

from dataclasses import dataclass, field

from xray_drake.configuration import count, number
from xray_drake.grasping.judgement import JudgementConfig
from xray_drake.grasping.perturbation import PerturbationConfig


@dataclass
class GraspPlannerConfig:
    """What all grasp planning shares; the numbers are those for models."""

    # Free space that must be left beside the widest object, m.
    min_clearance: float = number(0.0025, "[0, 0.1]")
    # How far beyond the contacts the jaw is commanded, m: the middle of the
    # pads then meets the contacts, where nothing stops it earlier.
    insertion: float = number(0.002, "[0, 0.1]")
    # Largest angle between approach and straight down, rad.
    max_tilt: float = number(1.05, "[0, 1.5708]")
    # Places on the object where the cup is laid, about.
    suction_samples: int = count(150, "[1, 100000]")
    # Turns of the cup about its axis that are tried.
    suction_turns: int = count(8, "[1, 360]")
    # Candidates whose free space is estimated, and those of them that are
    # judged, at most.
    max_candidates: int = count(800, "[1, 1000000]")
    max_checks: int = count(100, "[1, 100000]")
    # A grasp with this much free space around the gripper loses nothing, m.
    full_clearance: float = number(0.008, "(0, 1]")
    # The best are judged again under this many perturbations; the share that
    # holds multiplies their quality. 0 leaves it out.
    rehearsals: int = count(6, "[0, 1000]")
    # How many of them.
    finalists: int = count(4, "[1, 1000]")
    # What a rehearsal perturbs by.
    perturbation: PerturbationConfig = field(default_factory=PerturbationConfig)
    # Grasps are alike if they are this near to each other, m and rad.
    same_position: float = number(0.005, "[0, 1]")
    same_angle: float = number(0.175, "[0, 3.1416]")
    # How execution is judged.
    judgement: JudgementConfig = field(default_factory=JudgementConfig)
