"""Runs one search from start to end."""

from collections.abc import Callable
from functools import partial

from pydrake.geometry import Meshcat

from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import Observer, begin_search
from xray_drake.search.record import SearchRecord
from xray_drake.search.transitions import TransitionRecall, Transitions
from xray_drake.station.scenario import Scenario

_SLICE = 0.5
"""s of simulated time between looks at Ctrl-C and the watchdog."""

LONGEST_ACTION = 30.0
"""s of simulated time that no action takes; a search longer than the horizon's
worth of it hangs."""


def run_search(
    search: Scenario | SearchDiagram,
    *,
    meshcat: Meshcat | None = None,
    observers: tuple[Observer, ...] = (),
    progress: Callable[[float], None] | None = None,
    transitions: Transitions | None = None,
) -> SearchRecord:
    """Runs a search until success, the horizon, or another end.

    Ctrl-C ends it with what has been recorded so far and ``end`` set to
    "interrupted".

    Args:
        search: a scenario, or a diagram made of one.
        meshcat: shows it, where a scenario is given.
        observers: told of decisions and of ends of actions.
        progress: told the share of the heap's drop that is done, where a
            scenario is given.
        transitions: of earlier searches on the same heap. Grasps that began one
            of them in the same order are not simulated again; grows.

    Raises:
        ValueError: transitions of execution by contact.
        ScenarioError: a scenario that cannot be used.
        HeapError: heap after heap failed.
        RuntimeError: the simulation failed.
    """
    if isinstance(search, Scenario):
        search = build_search_diagram(
            search, meshcat=meshcat, progress=progress
        )
    recall = None
    if transitions is not None:
        recall = TransitionRecall(search, transitions)
        observers += (recall,)
    simulator, monitor = begin_search(search, observers=observers)
    if recall is not None:
        simulator.set_monitor(partial(recall.stops, monitor))
    record = monitor.record
    limit = LONGEST_ACTION * search.scenario.horizon
    try:
        simulator.Initialize()
        while not record.end:
            time = simulator.get_context().get_time()
            if time > limit:
                raise RuntimeError(
                    f"no end after {limit:.0f} s of simulated time (seed "
                    f"{record.seed}): a system of the diagram hangs"
                )
            simulator.AdvanceTo(time + _SLICE)
            if recall is not None:
                recall.skip(simulator)
    except KeyboardInterrupt:
        record.end = record.end or "interrupted"
    return record
