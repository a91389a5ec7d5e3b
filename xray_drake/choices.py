"""The names that a scenario and the command line choose from.

Needs the standard library alone, so that ``--help`` and readers of datasets
need no more.
"""

import logging
from functools import cache

BOX_TARGETS = tuple(f"box_{ratio}to1" for ratio in range(1, 11))
"""The boxes of aspect ratio 1 to 10, 9 cm² each (paper section IV.A)."""

TARGET_NAMES = (*BOX_TARGETS, "lid", "domino", "flute")
"""Targets that are flat."""

TALL_TARGETS = ("cube", "mug")
"""▲ Targets that are not flat: a heap is dropped on them lying on any face."""

DETECTORS = ("ground_truth", "hsv")
SEGMENTERS = ("ground_truth", "depth")
OCCUPANCIES = ("learned", "posterior", "geometric", "geometric_label")
"""What infers the occupancy distribution (README, "Which inference")."""

WITHOUT_NETWORK = ("geometric", "geometric_label")
"""Those of the occupancies that need no weights."""

OLD_OCCUPANCIES = {"exact": "geometric", "expected": "geometric_label"}
"""What they were called up to version 0.1; taken until version 0.3."""

DTYPES = ("float32", "bfloat16")
"""What networks can compute in; the first by default."""

GRASPS = ("models", "depth")
EXECUTIONS = ("quasi_static", "contact")

MESH_TIME_LIMIT = 300.0
"""s that preparing one mesh file may take; most take a few."""

CARRIERS = ("wrist", "arm")
"""What carries the gripper by contact."""


@cache
def current_occupancy(name: str) -> str:
    """Returns today's name of an inference that may go by its old one.

    A name that is out of date is told once per process; one that is none of
    :data:`OCCUPANCIES` comes back as it is.
    """
    new = OLD_OCCUPANCIES.get(name, name)
    if new != name:
        logging.getLogger(__name__).warning(
            "occupancy %r is now called %r; the old name goes with version 0.3",
            name,
            new,
        )
    return new
