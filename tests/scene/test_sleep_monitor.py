from collections.abc import Callable, Iterable

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from tests.scene.placed import HALF, Cubes
from xray_drake.scene.sleep_monitor import (
    SleepConfig,
    SleepMonitor,
    attach_sleep,
)

LOOK = SleepConfig().look_period


class Watched(Cubes):
    """Cubes and the monitor that puts them to sleep.

    Attributes:
        awake: names of cubes that are pulled at.
    """

    def __init__(
        self,
        config: SleepConfig | None = None,
        **positions: tuple[float, float, float],
    ) -> None:
        super().__init__(**positions)
        self.awake: set[str] = set()
        self.monitor = SleepMonitor(
            self.plant, self.scene_graph, self.items.values(), config=config
        )
        self.simulator.set_monitor(
            lambda root: self.monitor(root, awake=self.awake)
        )

    def until(self, condition: Callable[[], bool], limit: float = 2.0) -> float:
        """Goes on step by step; returns the time that it took."""
        start = self.root.get_time()
        while not condition():
            self.advance(0.005)
            assert self.root.get_time() < start + limit
        return self.root.get_time() - start

    def fall_asleep(self, *names: str) -> None:
        wanted = set(names or self.items)
        self.until(lambda: self.locked() >= wanted)


def stack(number: int, **others: tuple[float, float, float]) -> Watched:
    """Cubes ``c0`` on the floor, ``c1`` on it, … that sleep, and others."""
    heights = [HALF + 2 * HALF * i for i in range(number)]
    cubes = Watched(
        None,
        **{f"c{i}": (0.0, 0.0, z - 3e-4 * i) for i, z in enumerate(heights)},
        **others,
    )
    cubes.fall_asleep()
    return cubes


@pytest.mark.parametrize("quiet_time", [0.1, 0.4])
def test_what_has_been_still_for_a_while_falls_asleep(
    quiet_time: float,
) -> None:
    cubes = Watched(
        SleepConfig(quiet_time=quiet_time),
        lower=(0.0, 0.0, HALF),
        upper=(0.0, 0.0, 3 * HALF),
    )
    took = cubes.until(lambda: bool(cubes.locked()))
    assert quiet_time <= took < quiet_time + 0.1
    cubes.fall_asleep()
    before = cubes.pose("upper")
    cubes.advance(0.3)
    assert cubes.monitor.asleep(cubes.root) == {"lower", "upper"}
    assert (cubes.pose("upper") == before).all()


def test_what_flies_never_sleeps_not_even_at_its_apex() -> None:
    cubes = Watched(flying=(0.0, 0.0, HALF))
    cubes.push("flying", 0.0, 0.0, 2.0)
    heights: list[float] = []
    while not heights or cubes.height("flying") > HALF + 1e-3:
        cubes.advance(0.005)
        heights.append(cubes.height("flying"))
        assert not cubes.locked()
    assert max(heights) == pytest.approx(HALF + 2.0**2 / 2 / 9.81, abs=0.01)
    cubes.fall_asleep("flying")


def test_a_cube_that_falls_wakes_what_it_is_about_to_strike() -> None:
    """And that cube's neighbours, but nothing else."""
    cubes = stack(2, near=(0.07, 0.0, HALF), ball=(0.2, 0.1, HALF))
    cubes.monitor.wake(cubes.root, ["ball"])
    cubes.put("ball", 0.0, 0.0, 0.3)
    woken_at: dict[str, float] = {}
    gap = 1.0
    while gap > 0.0:
        gap = cubes.height("ball") - cubes.height("c1") - 2 * HALF
        cubes.advance(0.005)
        for name in {"c0", "c1", "near"} - cubes.locked():
            woken_at.setdefault(name, gap)
    assert set(woken_at) == {"c0", "c1"}
    # Before it is there, and not much before: it falls 2 m/s.
    assert all(0.0 < distance < 0.07 for distance in woken_at.values())
    cubes.fall_asleep()
    assert cubes.height("ball") == pytest.approx(5 * HALF, abs=1e-3)


def test_what_comes_slowly_leans_on_sleepers_as_on_the_bin() -> None:
    cubes = stack(1, other=(0.15, 0.1, HALF))
    cubes.monitor.wake(cubes.root, ["other"])
    cubes.put("other", 0.0, 0.0, 3 * HALF + 2e-3)
    cubes.monitor.forget()
    before = cubes.pose("c0")
    cubes.fall_asleep()
    assert (cubes.pose("c0") == before).all()
    assert cubes.height("other") == pytest.approx(3 * HALF, abs=5e-4)


@pytest.mark.parametrize("support", ["asleep", "awake", "dozing off"])
def test_what_loses_its_support_wakes_and_falls(support: str) -> None:
    cubes = stack(3, far=(0.1, 0.1, HALF))
    if support == "awake":
        cubes.monitor.wake(cubes.root, ["c0"])
    if support == "dozing off":
        cubes.monitor.wake(cubes.root, ["c0", "c1", "c2"])
        cubes.advance(SleepConfig().quiet_time - 0.01)
        assert cubes.locked() == {"far"}
    cubes.put("c0", -0.15, 0.0, HALF)
    cubes.advance(2 * LOOK)
    assert "c1" not in cubes.locked()
    assert "far" in cubes.locked()
    cubes.fall_asleep()
    for name, height in {"c0": HALF, "c1": HALF, "c2": 3 * HALF}.items():
        assert cubes.height(name) == pytest.approx(height, abs=5e-4)


def test_a_support_that_leaves_slowly_does_not_leave_sleepers_behind() -> None:
    """At each look it is but 1 mm farther."""
    cubes = stack(2)
    sunk = 0.0
    while "c1" in cubes.locked():
        sunk += 2e-4
        assert sunk < 6e-3
        cubes.put("c0", 0.0, 0.0, HALF - sunk)
        cubes.advance(0.005)
    assert sunk > SleepConfig().drift


@pytest.mark.parametrize(
    ("speed", "sleeps"), [(1e-3, True), (2e-3, True), (10e-3, False)]
)
def test_what_creeps_slowly_enough_counts_as_still(
    speed: float, sleeps: bool
) -> None:
    cubes = Watched(creeping=(0.0, 0.0, HALF))
    for i in range(60):
        cubes.put("creeping", speed * 0.005 * i, 0.0, HALF)
        cubes.advance(0.005)
        if cubes.locked():
            break
    assert bool(cubes.locked()) is sleeps


@pytest.mark.parametrize(
    ("pulled", "awake"),
    [
        ("far", {"far"}),
        ("c3", {"c3", "c2"}),
        ("c2", {"c1", "c2", "c3"}),
        ("c0", {"c0", "c1", "c2", "c3"}),
    ],
)
def test_what_is_pulled_at_stays_awake_with_all_that_holds_it(
    pulled: str, awake: set[str]
) -> None:
    cubes = stack(4, far=(0.1, 0.1, HALF))
    cubes.monitor.forget()  # at the first look already
    cubes.awake = {pulled}
    for _ in range(10):
        cubes.advance(2 * LOOK)
        assert set(cubes.items) - cubes.locked() == awake
    cubes.awake = set()
    cubes.fall_asleep()


def test_what_is_lifted_lifts_what_sleeps_on_it() -> None:
    cubes = stack(3, far=(0.1, 0.1, HALF))
    before = [cubes.height(name) for name in ("c0", "c1", "c2")]
    cubes.awake = {"c0"}
    cubes.advance(LOOK)
    for _ in range(30):
        cubes.push("c0", 0.0, 0.0, 0.5)
        cubes.advance(0.005)
        assert cubes.locked() == {"far"}
    after = [cubes.height(name) for name in ("c0", "c1", "c2")]
    assert np.subtract(after, before).min() > 5e-3


def test_a_pulled_cube_leaves_the_sleepers_that_it_was_among() -> None:
    cubes = stack(3)
    cubes.awake = {"c1"}
    cubes.advance(LOOK)
    cubes.put("c1", 0.15, 0.1, 0.2)
    cubes.awake = set()
    cubes.fall_asleep()
    assert cubes.height("c1") == pytest.approx(HALF, abs=5e-4)
    assert cubes.height("c2") == pytest.approx(3 * HALF, abs=5e-4)


def restart(cubes: Watched) -> None:
    """As after ``Simulator.reset_context``."""
    cubes.simulator.reset_context(cubes.diagram.CreateDefaultContext())
    cubes.simulator.Initialize()
    cubes.root = cubes.simulator.get_mutable_context()
    cubes.context = cubes.plant.GetMyMutableContextFromRoot(cubes.root)


def go_back(cubes: Watched) -> None:
    cubes.monitor.wake(cubes.root, ["c0", "c1"])
    cubes.root.SetTime(0.0)
    cubes.simulator.Initialize()


def forget(cubes: Watched) -> None:
    cubes.monitor.wake(cubes.root, ["c0", "c1"])
    cubes.advance(SleepConfig().quiet_time - LOOK)
    cubes.monitor.forget()


def wake_twice(cubes: Watched) -> None:
    cubes.monitor.wake(cubes.root, ["c1"])
    cubes.advance(SleepConfig().quiet_time - LOOK)
    cubes.monitor.wake(cubes.root, ["c1"])


def let_one_sleep(cubes: Watched) -> None:
    cubes.monitor.set_asleep(cubes.root, ["c0"])


@pytest.mark.parametrize(
    "disturb", [restart, go_back, forget, wake_twice, let_one_sleep]
)
def test_who_is_woken_or_forgotten_must_be_still_anew(
    disturb: Callable[[Watched], None],
) -> None:
    cubes = stack(2)
    disturb(cubes)
    assert "c1" not in cubes.locked()
    took = cubes.until(lambda: "c1" in cubes.locked())
    quiet_time = SleepConfig().quiet_time
    assert quiet_time <= took < quiet_time + 0.1
    assert cubes.locked() == {"c0", "c1"}
    assert cubes.height("c1") == pytest.approx(3 * HALF, abs=5e-4)


def test_it_looks_once_per_period() -> None:
    cubes = Watched(SleepConfig(look_period=0.02), cube=(0.0, 0.0, HALF))
    times: list[float] = []
    look = cubes.monitor.look

    def noted(root: Context, *, awake: Iterable[str] = ()) -> None:
        times.append(root.get_time())
        look(root, awake=awake)

    cubes.monitor.look = noted  # type: ignore[method-assign]
    cubes.advance(0.1)
    assert times == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08, 0.1])


@pytest.mark.parametrize("inside_another", [False, True])
def test_a_users_own_diagram_with_a_plain_simulator(
    inside_another: bool,
) -> None:
    cubes = Cubes(lower=(0.0, 0.0, HALF), upper=(0.0, 0.0, 0.1))
    diagram = cubes.diagram
    if inside_another:
        builder = DiagramBuilder()
        builder.AddSystem(diagram)
        diagram = builder.Build()
    simulator = Simulator(diagram)
    monitor = attach_sleep(
        simulator,
        cubes.plant,
        cubes.scene_graph,
        cubes.items.values(),
        config=SleepConfig(quiet_time=0.2),
    )
    simulator.AdvanceTo(0.15)
    assert monitor.asleep(simulator.get_context()) == set()
    simulator.AdvanceTo(1.0)
    root = simulator.get_context()
    assert monitor.asleep(root) == {"lower", "upper"}
    cubes.context = cubes.plant.GetMyContextFromRoot(root)
    assert cubes.height("upper") == pytest.approx(3 * HALF, abs=5e-4)


def test_what_went_to_nan_does_not_sleep() -> None:
    cubes = stack(1, lost=(0.1, 0.1, HALF))
    cubes.monitor.wake(cubes.root, ["lost"])
    cubes.put("lost", 0.0, np.nan, HALF)
    for i in range(20):
        cubes.root.SetTime(1.0 + LOOK * i)
        cubes.monitor(cubes.root)
    assert cubes.locked() == {"c0"}


@pytest.mark.parametrize(
    "call",
    [
        lambda monitor, root: monitor.wake(root, ["nobody"]),
        lambda monitor, root: monitor.set_asleep(root, ["c0", "nobody"]),
        lambda monitor, root: monitor.look(root, awake=["nobody"]),
    ],
)
def test_unknown_names(call: Callable[[SleepMonitor, Context], None]) -> None:
    cubes = stack(1)
    with pytest.raises(KeyError, match="nobody"):
        call(cubes.monitor, cubes.root)
    assert cubes.locked() == {"c0"}
    with pytest.raises(ValueError, match="no body"):
        SleepMonitor(cubes.plant, cubes.scene_graph, [])


def near_a_mover(gap: float, **push: float) -> bool:
    """Says whether a cube wakes so far from another that is a mover, m."""
    cubes = Cubes(c=(0.0, 0.0, HALF), m=(0.15, 0.0, HALF))
    mover = cubes.items.pop("m")
    monitor = SleepMonitor(
        cubes.plant,
        cubes.scene_graph,
        cubes.items.values(),
        movers=[mover.body],
    )
    cubes.simulator.set_monitor(monitor)
    cubes.advance(0.5)
    assert cubes.locked() == {"c"}
    assert not mover.joint.is_locked(cubes.context)
    X_WM = RigidTransform([2 * HALF + gap, 0.0, HALF])
    mover.joint.SetPose(cubes.context, X_WM)
    speed = np.array([push.get("speed", 0.0), 0.0, 0.0])
    mover.joint.set_translational_velocity(cubes.context, speed)
    cubes.advance(LOOK)
    return not cubes.locked()


def test_a_mover_wakes_what_it_comes_near() -> None:
    # Drake bounds a cube by a box that is up to its width too wide.
    far = 2.5 * HALF
    assert near_a_mover(0.5 * SleepConfig().reach)
    assert not near_a_mover(far)
    # What it is about to reach before the next look, too.
    assert near_a_mover(far, speed=-far / LOOK)
