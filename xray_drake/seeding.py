"""Random generators that are independent of each other by name."""

import zlib

import numpy as np


def stream(seed: int, purpose: str, *numbers: int) -> np.random.Generator:
    """Returns the generator of one purpose under a scenario's seed.

    Two purposes never share a stream, so that, say, a planner cannot meet the
    very perturbation that the execution draws.

    Args:
        seed: of the scenario; not negative.
        purpose: what it is for.
        numbers: which of several, not negative; with other numbers, or
            another count of them, it is another stream.
    """
    if numbers[-1:] == (0,):
        # NumPy ignores zeros at the end of a seed.
        purpose, numbers = repr((purpose, *map(int, numbers))), ()
    return np.random.default_rng([seed, zlib.crc32(purpose.encode()), *numbers])
