"""The names that a scenario and the command line choose from.

Free of imports, so that ``--help`` and readers of datasets need no more.
"""

BOX_TARGETS = tuple(f"box_{ratio}to1" for ratio in range(1, 11))
"""The boxes of aspect ratio 1 to 10, 9 cm² each (paper section IV.A)."""

TARGET_NAMES = (*BOX_TARGETS, "lid", "domino", "flute")
"""Targets that are flat."""

TALL_TARGETS = ("cube", "mug")
"""▲ Targets that are not flat: a heap is dropped on them lying on any face."""

DETECTORS = ("ground_truth", "hsv")
SEGMENTERS = ("ground_truth", "depth")
OCCUPANCIES = ("learned", "posterior", "exact", "expected")

WITHOUT_NETWORK = ("exact", "expected")
"""Those of the occupancies that need no weights."""

DTYPES = ("float32", "bfloat16")
"""What networks can compute in; the first by default."""

GRASPS = ("models", "depth")
EXECUTIONS = ("quasi_static", "contact")

CARRIERS = ("wrist", "arm")
"""What carries the gripper by contact."""
