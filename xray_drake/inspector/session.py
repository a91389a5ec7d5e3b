"""A search driven by buttons in Meshcat."""

from collections.abc import Callable
from dataclasses import replace

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from xray_drake.inspector.controls import Controls
from xray_drake.inspector.recording import SearchDrawing
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.monitor import Observer, SearchMonitor, begin_search
from xray_drake.search.record import SearchRecord
from xray_drake.station.scenario import Scenario

BUTTONS = ("step", "run", "new heap")

_SLICE = 0.1


class InteractiveSearch:
    """A search with the buttons "step", "run" and "new heap" in Meshcat.

    "step" goes on until the policy has decided what to do next, and shows it;
    "run" goes on to the end; "new heap" takes the next seed and waits.

    Attributes:
        record: of the search on show.
    """

    def __init__(
        self,
        scenario: Scenario,
        meshcat: Meshcat,
        *,
        observers: tuple[Observer, ...] = (),
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Adds the buttons; nothing is dropped yet.

        Args:
            scenario: the first search.
            meshcat: where to show it.
            observers: told of decisions and of ends of actions.
            progress: told the share of a heap's drop that is done.
        """
        self._scenario = scenario
        self._meshcat = meshcat
        self._observers = observers
        self._progress = progress
        self._running = False
        self._until = 0
        self._simulator: Simulator | None = None
        self._monitor: SearchMonitor | None = None
        self._controls = Controls(meshcat)
        for name in BUTTONS:
            self._controls.add_button(name)

    @property
    def record(self) -> SearchRecord | None:
        """What has happened so far; None before the first heap."""
        return self._monitor.record if self._monitor else None

    @property
    def _decided(self) -> int:
        return len(self.record.actions) if self.record else 0

    def new_heap(self, seed: int) -> None:
        """Drops a heap and waits for a button."""
        self._scenario = replace(self._scenario, seed=seed)
        self._simulator = self._monitor = None
        self._meshcat.Delete()
        diagram = build_search_diagram(
            self._scenario, meshcat=self._meshcat, progress=self._progress
        )
        drawing = SearchDrawing(self._meshcat)
        self._simulator, self._monitor = begin_search(
            diagram, observers=(drawing, *self._observers)
        )
        self._running, self._until = False, 0
        self._simulator.Initialize()

    def step(self) -> None:
        """Goes on until the next decision."""
        self._running, self._until = True, self._decided + 1

    def run(self) -> None:
        """Goes on to the end of the search."""
        self._running, self._until = True, 10**9

    def poll(self) -> bool:
        """Reacts to the buttons and goes on for a moment.

        Returns:
            False where there was nothing to do.
        """
        clicked = self._controls.clicked()
        if self._simulator is None or self._monitor is None:
            self.new_heap(self._scenario.seed)
            return True
        if "new heap" in clicked:
            self.new_heap(self._scenario.seed + 1)
            return True
        if "run" in clicked:
            self.run()
        elif "step" in clicked:
            self.step()
        if self._monitor.record.end:
            self._running = False
        if not self._running:
            return False
        now = self._simulator.get_context().get_time()
        self._simulator.AdvanceTo(now + _SLICE)
        if self._decided >= self._until:
            self._running = False
        return True

    def loop(self) -> None:
        """Serves the buttons until Ctrl-C."""
        self._controls.serve(self.poll)
        if self.record is not None and not self.record.end:
            self.record.end = "interrupted"
