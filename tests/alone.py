"""One system of a diagram alone: fix its inputs, look at its outputs."""

from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import System

from tests.ports import fix_inputs


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
        """Fixes inputs by their names, as `fix_inputs` does."""
        fix_inputs(self.system, self.context, **inputs)

    def advance(self, duration: float = 0.2) -> None:
        self._simulator.AdvanceTo(self.context.get_time() + duration)

    def advance_to(self, time: float) -> Any:
        """Handles what is due at that time, too; returns the first output."""
        self._simulator.AdvanceTo(time)
        self._simulator.AdvancePendingEvents()
        return self.system.get_output_port(0).Eval(self.context)

    def output(self, name: str) -> Any:
        return self.system.GetOutputPort(name).Eval(self.context)
