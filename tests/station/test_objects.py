from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from xray_drake.scene.drop import drop_heap
from xray_drake.scene.heap import (
    Heap,
    HeapError,
)
from xray_drake.scene.library import object_names, split_of
from xray_drake.station import objects as module
from xray_drake.station.config import RandomNumber
from xray_drake.station.objects import (
    choose_objects,
    imported_objects,
    make_heap,
    snapshot_counts,
    truncated_poisson,
)
from xray_drake.station.scenario import (
    Scenario,
    ScenarioError,
    load_scenario,
)
from xray_drake.station.start import TargetView, look_at_heap


def scenario(seed: int = 10_000, count: int = 3, *meshes: Path) -> Scenario:
    result = Scenario(seed=seed)
    result.scene.num_objects = count
    result.scene.meshes = [str(folder) for folder in meshes]
    result.scene.heap.drop_period = 0.1
    return result


def chosen(given: Scenario) -> list[str]:
    return [model.name for model in choose_objects(given)]


def folder_of_boxes(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True)
    for i, name in enumerate(names):
        mesh = trimesh.creation.box((0.03, 0.04, 0.05 + 0.01 * i))
        mesh.export(folder / f"{name}.obj")
    return folder


def test_the_seed_chooses() -> None:
    one = chosen(scenario(10_000, 14))
    assert chosen(scenario(10_000, 14)) == one
    assert set(one) <= set(object_names(split="train"))
    assert chosen(scenario(10_001, 14)) != one


def test_without_replacement_while_the_library_lasts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few = object_names("can", split="train")
    monkeypatch.setattr(
        "xray_drake.station.objects.object_names", lambda **_: few
    )
    assert sorted(chosen(scenario(10_000, len(few)))) == sorted(few)
    more = chosen(scenario(10_000, len(few) + 5))
    assert len(set(more)) == len(few) + 5


def test_meshes_replace_the_library_and_add_up(tmp_path: Path) -> None:
    cups = folder_of_boxes(tmp_path / "cups", "red", "blue")
    toys = folder_of_boxes(tmp_path / "toys", "duck")
    names = chosen(scenario(10_000, 3, cups, toys))
    assert sorted(names) == ["cups/blue", "cups/red", "toys/duck"]
    few = chosen(scenario(10_000, 3, toys))
    assert len(set(few)) == 3
    assert all(name.startswith("toys/duck") for name in few)
    # Two folders of one name do, too.
    more = folder_of_boxes(tmp_path / "more" / "toys", "duck", "duck2")
    models = choose_objects(scenario(10_000, 3, toys, more))
    assert len(models) == 3
    heights = {round(float(model.extents.max()), 3) for model in models}
    assert heights == {0.05, 0.06}
    assert not any("copy" in model.name for model in models)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="nowhere"):
        choose_objects(scenario(10_000, 3, tmp_path / "nowhere"))


def test_the_heap_of_a_scenario() -> None:
    wanted = scenario()
    wanted.scene.target = "domino"
    heap = make_heap(wanted)
    assert (heap.target.name, heap.seed) == ("domino", 10_000)
    again = drop_heap(
        heap.target,
        choose_objects(wanted),
        wanted.seed,
        config=wanted.scene.heap,
        plant_config=wanted.plant_config,
    )
    for name, X_WO in heap.poses.items():
        np.testing.assert_array_equal(again.poses[name], X_WO)


def test_what_falls_and_how_it_falls_are_independent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No two purposes may draw the same random numbers."""
    make = np.random.default_rng
    starts: list[str] = []

    def recorded(*args: Any) -> np.random.Generator:
        rng = make(*args)
        starts.append(str(rng.bit_generator.state["state"]))
        return rng

    wanted = scenario(10_000, 1)
    choose_objects(wanted)  # builds the library's object, by its own stream
    monkeypatch.setattr(np.random, "default_rng", recorded)
    heap = make_heap(wanted)
    assert heap.attempts == 1
    assert len(starts) == len(set(starts)) == 2


def test_the_number_is_poisson_between_its_ends() -> None:
    """The paper: mean 12, from 10 to 15 (section IV.A)."""
    rng = np.random.default_rng(0)
    number = RandomNumber(mean=12.0, least=10, most=15)
    drawn = [truncated_poisson(number, rng) for _ in range(4000)]
    share = np.bincount(drawn, minlength=17) / len(drawn)
    assert set(drawn) == set(range(10, 16))
    # P(11) / P(12) = 12 / 12, P(15) / P(12) = 12^3 / (13 · 14 · 15).
    assert share[11] / share[12] == pytest.approx(1, abs=0.15)
    assert share[15] / share[12] == pytest.approx(0.633, abs=0.1)


def test_the_papers_heaps_differ_in_number() -> None:
    """And nothing in them is packaged."""
    paper = load_scenario("paper")
    drawn = [chosen(paper) for paper.seed in range(12)]
    counts = {len(names) for names in drawn}
    assert len(counts) > 2
    assert 10 <= min(counts) <= max(counts) <= 15
    assert not any(n.endswith("_packaged") for names in drawn for n in names)


def share_packaged(names: list[str]) -> float:
    return np.mean([name.endswith("_packaged") for name in names])


def test_packages_are_drawn_on_request() -> None:
    given = scenario(10_000, 60)
    given.scene.packaged = True
    assert 0.05 < share_packaged(chosen(given)) < 0.45


def test_table_2_has_the_papers_share_of_packages_and_nothing_trained_on() -> (
    None
):
    """13 of 59, as in the paper, though 42 of 211 are packaged."""
    given = load_scenario("table2")
    drawn = []
    for seed in range(300):
        given.seed = seed
        names = chosen(given)
        assert len(set(names)) == len(names) == 14
        drawn += names
    # Binomial: σ = 0.0064; 42 of 211 are 0.199.
    assert share_packaged(drawn) == pytest.approx(13 / 59, abs=0.015)
    plain = {name.removesuffix("_packaged") for name in drawn}
    assert len(plain) > 100
    assert all(split_of(name) == "test" for name in plain)


@pytest.mark.parametrize("share", [1.0, 0.9, 0.1])
def test_too_few_packages_come_again(share: float) -> None:
    given = load_scenario("table2")
    given.scene.packaged_share, given.scene.num_objects = share, 60
    assert len(set(chosen(given))) == 60


class Drops:
    """Stands in for drops: heaps that are as visible as is said."""

    def __init__(self, *visible: float) -> None:
        self.seeds: list[int] = []
        self.objects: list[list[str]] = []
        self._visible = iter(visible)

    def drop(self, target: Any, objects: Any, seed: int, **_: Any) -> Heap:
        self.seeds.append(seed)
        self.objects.append([model.name for model in objects])
        return Heap(
            target=target,
            objects=tuple(objects),
            poses={},
            seed=seed,
            num_dropped=len(objects),
            attempts=2,
            settle_time=1.0,
            failures=(f"seed {seed} failed",),
        )

    def look(self, scenario: Scenario, heap: Heap) -> TargetView:
        return TargetView(400, next(self._visible), 0, 0.0, 0)


@pytest.fixture
def dropping(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Drops]:
    """Has the next heaps be as visible as is said."""

    def begun(*visible: float) -> Drops:
        drops = Drops(*visible)
        monkeypatch.setattr(module, "drop_heap", drops.drop)
        monkeypatch.setattr(module, "look_at_heap", drops.look)
        return drops

    return begun


def test_heaps_that_show_their_target_are_drawn_again(
    dropping: Callable[..., Drops],
) -> None:
    given = load_scenario("table2")
    given.seed = 10_000
    drops = dropping(0.95, 0.91, 0.9)
    heap = make_heap(given)
    assert (heap.seed, heap.attempts, heap.redrawn) == (10_000, 6, 2)
    assert [m.name for m in heap.objects] == drops.objects[2]
    assert drops.seeds[0] == 10_000
    assert len(set(drops.seeds)) == 3
    assert len({tuple(names) for names in drops.objects}) == 3
    assert len(heap.failures) == 3
    # Whoever searches it gets the same.
    given.policy.name = "random"
    again = dropping(0.95, 0.91, 0.9)
    make_heap(given)
    assert (again.seeds, again.objects) == (drops.seeds, drops.objects)


def test_other_scenarios_take_every_heap(
    dropping: Callable[..., Drops],
) -> None:
    drops = dropping()  # nobody looks
    heap = make_heap(load_scenario("demo"))
    assert (heap.attempts, heap.redrawn, drops.seeds) == (2, 0, [0])


def test_a_scenario_that_never_hides_its_target_is_an_error(
    dropping: Callable[..., Drops],
) -> None:
    drops = dropping(*[1.0] * 99)
    with pytest.raises(HeapError, match="90% of the target"):
        make_heap(load_scenario("table2"))
    assert len(drops.seeds) == 51


def test_a_heap_is_looked_at_before_it_counts() -> None:
    """One object does not cover the target in most of the draws."""
    given = scenario(10_000, 1)
    given.scene.most_visible = 0.9
    heap = make_heap(given)
    assert look_at_heap(given, heap).target_visible_fraction <= 0.9
    assert heap.redrawn > 0


def test_meshes_in_another_unit(tmp_path: Path) -> None:
    trimesh.creation.box((30, 40, 50)).export(tmp_path / "a.stl")
    given = scenario(10_000, 1, tmp_path)
    given.scene.mesh_scale = 1e-3
    (model,) = imported_objects(given).values()
    assert max(model.extents) == pytest.approx(0.05)


def test_numbers_of_snapshots() -> None:
    """Evenly from half of the objects on, as long as they differ."""
    assert snapshot_counts(0, 1) == snapshot_counts(12, 1) == ()
    assert snapshot_counts(12, 3) == (8, 10)
    for number in range(30):
        for snapshots in range(2, 12):
            try:
                counts = snapshot_counts(number, snapshots)
            except ValueError:
                assert number < 2 * snapshots
                continue
            assert len(counts) == snapshots - 1
            assert list(counts) == sorted(set(counts))
            assert number / 2 - 1 < counts[0] and counts[-1] < number


def test_snapshots_are_spread_over_the_growth() -> None:
    given = scenario(10_000, 4)
    given.scene.heap.snapshot_timeout = 0.1
    heap = make_heap(given, snapshots=2)
    assert [state.num_dropped for state in (*heap.growth, heap)] == [3, 4]
