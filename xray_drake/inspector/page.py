"""A Meshcat page with sliders and buttons to inspect heaps and searches."""

from collections.abc import Callable
from dataclasses import replace

from xray_drake.faults import BREAKDOWNS, one_line
from xray_drake.inspector.controls import Controls
from xray_drake.inspector.layers import LAYERS
from xray_drake.inspector.replay import (
    Replay,
    first_decision,
    replay_search,
)
from xray_drake.inspector.snapshot import ranking_lines
from xray_drake.inspector.view import ReplayView
from xray_drake.scene.targets import TARGET_NAMES
from xray_drake.station.config import MOST_OBJECTS
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import (
    Scenario,
)

STEP, BACK, NEXT, SEARCH = "step", "back", "next", "search this heap"
HEAP_OPACITY = "heap opacity"
SEED, TARGET, OBJECTS = "seed", "target", "objects"

_LAYER_GRAIN, _HEAP_GRAIN = 0.25, 0.125
"""Of opacities; binary fractions, which the page shows without a long tail."""

_SEEDS = 100
"""So many seeds a slider spans."""

_USUAL_OBJECTS = 30


class InspectorPage:
    """A heap or a search in Meshcat, with controls.

    ``step``, ``back`` and ``next`` go through the decisions (keys: the arrows
    left and right). A slider for each layer switches it off (0) and on (1) or
    makes it translucent; ``heap opacity`` shows the target under the heap.
    ``search this heap`` runs the search to its end. ``seed``, ``target`` and
    ``objects`` choose another heap; the last button says which that is, and
    drops it.

    Attributes:
        view: what is shown.
    """

    def __init__(
        self,
        view: ReplayView,
        *,
        opacity: float = 1.0,
        announce: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Adds the controls.

        Args:
            view: what is shown first.
            opacity: of its heap.
            announce: told in a line what is shown or done.
        """
        self.view = view
        self._controls = Controls(view.meshcat)
        self._announce = announce
        self._heap_opacity = opacity
        self._last = ""
        self._targets = TARGET_NAMES
        self._add_controls()
        self._tell()

    def poll(self) -> bool:
        """Reacts to sliders and buttons.

        Returns:
            False where there was nothing to do.
        """
        moved, clicked = self._controls.moved(), self._controls.clicked()
        for layer in LAYERS:
            if layer.name in moved:
                self.view.layers.set_opacity(layer.name, moved[layer.name])
        if HEAP_OPACITY in moved:
            self._heap_opacity = moved[HEAP_OPACITY]
            self.view.set_heap_opacity(self._heap_opacity)
        if self._last in clicked:
            self._drop(self._chosen())
        elif SEARCH in clicked:
            self._search()
        else:
            step = round(moved.get(STEP, self.view.step))
            self._go(step + clicked.get(NEXT, 0) - clicked.get(BACK, 0))
            if {SEED, TARGET, OBJECTS} & set(moved):
                self._label_last()
        return bool(moved or clicked)

    def loop(self) -> None:
        """Serves the page until Ctrl-C."""
        self._controls.serve(self.poll)

    def _go(self, step: int) -> None:
        step = min(max(step, 1), self.view.num_steps)
        if step != self.view.step:
            self.view.show(step)
            self._tell()
        self._controls.set_slider(STEP, step)

    def _tell(self) -> None:
        view = self.view
        self._announce("; ".join(view.describe(view.step)[1:]))
        for shot in view.replay.snapshots[view.step - 1 : view.step]:
            for line in ranking_lines(shot.action):
                self._announce(f"  {line}")

    def _show(self, replay: Replay) -> None:
        """Replaces what is shown; layers stay on or off."""
        before = {
            layer.name: self.view.layers.opacity(layer.name) for layer in LAYERS
        }
        self.view = ReplayView(replay, self.view.meshcat)
        for name, opacity in before.items():
            self.view.layers.set_opacity(name, opacity)
        self.view.set_heap_opacity(self._heap_opacity)
        self._add_controls()
        self._tell()

    def _add_controls(self) -> None:
        controls, replay = self._controls, self.view.replay
        controls.clear()
        self._last = ""
        if self.view.num_steps > 1:
            controls.add_slider(STEP, 1, self.view.num_steps, 1, self.view.step)
            controls.add_button(BACK, "ArrowLeft")
            controls.add_button(NEXT, "ArrowRight")
        if not replay.ended:
            controls.add_button(SEARCH)
        for layer in LAYERS:
            grain = _LAYER_GRAIN if layer.translucent else 1
            value = self.view.layers.opacity(layer.name)
            controls.add_slider(layer.name, 0, 1, grain, value)
        controls.add_slider(HEAP_OPACITY, 0, 1, _HEAP_GRAIN, self._heap_opacity)
        scene, seed = replay.scenario.scene, replay.scenario.seed
        first = seed - seed % _SEEDS
        controls.add_slider(SEED, first, first + _SEEDS - 1, 1, seed)
        if scene.target not in self._targets:
            self._targets += (scene.target,)
        controls.add_slider(
            TARGET,
            1,
            len(self._targets),
            1,
            1 + self._targets.index(scene.target),
        )
        count = replay.heap.num_dropped
        most = min(max(_USUAL_OBJECTS, 2 * count), MOST_OBJECTS)
        controls.add_slider(OBJECTS, 1, most, 1, count)
        self._label_last()

    def _label_last(self, label: str = "") -> None:
        """Renames the last button; by default it says what it would drop."""
        if not label:
            chosen = self._chosen()
            label = (
                f"drop {chosen.scene.target}, {chosen.scene.num_objects} "
                f"objects, seed {chosen.seed}"
            )
        if label != self._last:
            self._controls.delete_button(self._last)
            self._last = label
            self._controls.add_button(label)

    def _chosen(self) -> Scenario:
        """Returns the scenario that the sliders say."""
        scenario, values = self.view.replay.scenario, self._controls.values
        return replace(
            scenario,
            seed=round(values[SEED]),
            scene=replace(
                scenario.scene,
                target=self._targets[round(values[TARGET]) - 1],
                num_objects=round(values[OBJECTS]),
                random_number=replace(scenario.scene.random_number, mean=0.0),
            ),
        )

    def _drop(self, scenario: Scenario) -> None:
        try:
            heap = make_heap(scenario, progress=self._progress("dropping"))
            self._label_last("deciding …")
            self._show(first_decision(scenario, heap))
        except (*BREAKDOWNS, ValueError) as error:
            self._fail(error)

    def _search(self) -> None:
        replay = self.view.replay
        try:
            self._show(
                replay_search(
                    replay.scenario,
                    replay.heap,
                    progress=self._progress("searching"),
                )
            )
        except BREAKDOWNS as error:
            self._fail(error)

    def _progress(self, what: str) -> Callable[[float], None]:
        """Returns a function that shows a share done on the last button."""
        self._announce(f"{what} …")
        self._label_last(f"{what} … 0%")
        return lambda share: self._label_last(f"{what} … {share:.0%}")

    def _fail(self, error: BaseException) -> None:
        self._announce(one_line(error))
        self._label_last()
