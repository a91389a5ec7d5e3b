"""One system of a diagram alone: fix its inputs, look at its outputs."""

from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import System
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I


class Alone:
    """A system under simulation, its abstract inputs fixed.

    Attributes:
        system: as given.
        context: of the simulation.
    """

    def __init__(self, system: System, **inputs: Any) -> None:
        self.system = system
        self._simulator = Simulator(system)
        self.context = self._simulator.get_mutable_context()
        self.fix(**inputs)

    def fix(self, **inputs: Any) -> None:
        """Fixes inputs by their names; (H, W) arrays become images."""
        for name, value in inputs.items():
            if isinstance(value, np.ndarray) and value.ndim == 2:
                floats = np.issubdtype(value.dtype, np.floating)
                image = (ImageDepth32F if floats else ImageLabel16I)(
                    *value.shape[::-1]
                )
                image.mutable_data[:, :, 0] = value
                value = image
            plain = isinstance(value, np.ndarray)
            self.system.GetInputPort(name).FixValue(
                self.context, value if plain else AbstractValue.Make(value)
            )

    def advance(self, duration: float = 0.2) -> None:
        self._simulator.AdvanceTo(self.context.get_time() + duration)

    def advance_to(self, time: float) -> Any:
        """Handles what is due at that time, too; returns the first output."""
        self._simulator.AdvanceTo(time)
        self._simulator.AdvancePendingEvents()
        return self.system.get_output_port(0).Eval(self.context)

    def output(self, name: str) -> Any:
        return self.system.GetOutputPort(name).Eval(self.context)
