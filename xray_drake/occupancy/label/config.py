"""The numbers of the label."""

from dataclasses import dataclass

from xray_drake.configuration import count, number


@dataclass
class LabelConfig:
    """Numbers of ``occupancy_label`` (paper section IV.A, PROTOCOL.md)."""

    # Candidates are this many pixels apart, in both directions: a 512×384
    # image has 64×48 of them.
    step: int = count(8, "[1, 256]")
    # Orientations over the full turn.
    rotations: int = count(16, "[1, 3600]")
    # How far a candidate may reach beyond the floor, m.
    floor_tolerance: float = number(0.002, "[0, 0.1]")
    # The target is seen where it is nearer than the scene by more than this, m.
    depth_tolerance: float = number(0.0001, "[0, 0.1]")
    # A candidate of a target that is seen has a greater IoU than this.
    accept_iou: float = number(0.9, "[0, 1)")
