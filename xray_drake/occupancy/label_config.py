"""The numbers of the label."""

from dataclasses import dataclass, field


@dataclass
class LabelConfig:
    """Numbers of ``occupancy_label`` (paper section IV.A, PROTOCOL.md)."""

    # Candidates are this many pixels apart, in both directions: a 512×384
    # image has 64×48 of them.
    step: int = 8
    # Orientations over the full turn.
    rotations: int = 16
    # Inside of the bin floor: x low, x high, y low, y high, m.
    floor: list[float] = field(
        default_factory=lambda: [-0.25, 0.25, -0.20, 0.20]
    )
    # How far a candidate may reach beyond the floor, m.
    floor_tolerance: float = 0.002
    # The target is seen where it is nearer than the scene by more than this, m.
    depth_tolerance: float = 0.0001
    # A candidate of a target that is seen has a greater IoU than this.
    accept_iou: float = 0.9
