"""What a family of objects is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from xray_drake.scene.shapes import Solid


@dataclass(frozen=True)
class Family:
    """A shape with free sizes.

    Attributes:
        shape: draws one member; all its randomness is from the generator.
        density: (lowest, highest) mean density of the matter inside the
            surface, kg/m³. A closed box is counted as filled.
        stretch: (lowest, highest) factors along x, y and z that give more
            variety than the shape alone has.
    """

    shape: Callable[[np.random.Generator], Solid]
    density: tuple[float, float]
    stretch: tuple[tuple[float, float], ...] = ((1, 1), (1, 1), (1, 1))

    def __call__(self, rng: np.random.Generator) -> tuple[Solid, float]:
        """Draws the shape and the density, kg/m³, of one member."""
        return self.shape(rng), float(rng.uniform(*self.density))

    def factors(self, rng: np.random.Generator) -> np.ndarray:
        """Draws the (3,) factors along x, y and z."""
        low, high = np.log(np.array(self.stretch, dtype=float)).T
        return np.exp(rng.uniform(low, high))
