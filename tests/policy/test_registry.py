"""Policies by name: the package's own, installed ones, registered ones."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.cli.running import answer
from xray_drake.benchmark.rollouts import run_rollouts
from xray_drake.benchmark.variants import Variant
from xray_drake.gym.agents import policy_agent
from xray_drake.inspector.replay import replay_search
from xray_drake.policy import registry
from xray_drake.policy.ranking import Scores, SearchView, largest, xray
from xray_drake.policy.registry import (
    POLICIES,
    Policies,
    Policy,
    PolicyError,
    for_workers,
    register_policy,
)
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import (
    Scenario,
    ScenarioError,
    check_scenario,
    parse_scenario,
)

SMALLEST = """
from xray_drake.policy.ranking import Scores, largest

def smallest(view, rng):
    scores = largest(view, rng)
    return Scores(-scores.values, scores.hides)
"""


def thinnest(view: SearchView, rng: np.random.Generator) -> Scores:
    """The least visible pixels first."""
    scores = largest(view, rng)
    return Scores(-scores.values, scores.hides)


@pytest.fixture(autouse=True)
def registered_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is forgotten after it."""
    monkeypatch.setattr(POLICIES, "registered", {})


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder for ``sys.path`` with an installed package and two policies."""
    (tmp_path / "shelf.py").write_text(SMALLEST, encoding="utf-8")
    info = tmp_path / "shelf-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: shelf\nVersion: 1.2\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(
        f"[{registry.GROUP}]\nsmallest = shelf:smallest\nbad = shelf:absent\n"
        "xray = shelf:smallest\n",
        encoding="utf-8",
    )
    return tmp_path


def test_the_package_has_eight() -> None:
    assert [*Policies()] == [
        *("xray", "largest", "random"),
        *("oracle", "memory", "lookahead", "grasp_aware", "combined"),
    ]
    assert POLICIES["xray"] == Policy(xray)
    blind = {name for name in POLICIES if POLICIES[name].blind}
    assert blind == {"largest", "random", "oracle"}
    assert all(not policy.source for policy in POLICIES.values())


def test_names_cost_no_import() -> None:
    code = (
        "import sys; from xray_drake.policy.registry import POLICIES;"
        "print(*POLICIES, sum(m in sys.modules for m in ('cv2', 'pydrake')))"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert told.stdout.split()[0] == "xray"
    assert told.stdout.split()[-1] == "0"


def test_entry_points_and_modules_are_found(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(installed)
    policies = Policies()
    assert {"smallest", "bad"} < {*policies}
    assert policies["smallest"].source == "shelf:smallest (shelf 1.2)"
    assert policies["shelf:smallest"].source == "shelf:smallest"
    assert policies["xray"] == POLICIES["xray"]
    with pytest.raises(PolicyError, match="'bad' cannot be imported from she"):
        policies["bad"]
    with pytest.raises(PolicyError, match=r"choose one of xray, .*, smallest"):
        policies["greedy"]


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("greedy", "no policy 'greedy': choose one of xray, largest"),
        ("", "no policy ''"),
        ("no_such_module:it", "ModuleNotFoundError"),
        ("os:sep", "neither a Policy nor a ranking, but '/'"),
    ],
)
def test_an_unknown_name_is_one_line(name: str, line: str) -> None:
    scenario = Scenario()
    scenario.policy.name = name
    with pytest.raises(ScenarioError, match=f"policy.name: .*{line}") as told:
        check_scenario(scenario)
    assert "\n" not in str(told.value)


def test_a_record_can_be_read_without_its_policy() -> None:
    text = "policy: {name: mine}"
    read = parse_scenario(text, "record", searched=False)
    assert read.policy.name == "mine"
    with pytest.raises(ScenarioError, match="no policy 'mine'"):
        parse_scenario(text, "record")


@pytest.mark.parametrize("name", ["xray", "", "a,b", "a:b", "a b"])
def test_some_names_cannot_be_registered(name: str) -> None:
    with pytest.raises(PolicyError, match="cannot be registered"):
        register_policy(name, thinnest)


def test_workers_are_told_what_they_can_import() -> None:
    mine = register_policy("mine", thinnest, memory=True, blind=True)
    place = f"{__name__}:thinnest"
    assert mine == Policy(thinnest, memory=True, blind=True, source=place)
    assert Variant.make("mine", "geometric", True).occupancy == ""
    assert Variant.make("yours", "geometric", True).occupancy == "geometric"
    assert for_workers(["xray", "mine"]) == {"mine": mine}
    register_policy("local", lambda view, rng: largest(view, rng))
    with pytest.raises(
        PolicyError, match=r"'local' .*put its ranking into a m"
    ):
        for_workers(["local"])


def test_a_registered_policy_works_wherever_the_package_has_one(
    tiny_heap: Heap, tiny_scenario: Scenario, tmp_path: Path
) -> None:
    """Search, record, replay for the inspector, benchmark's workers, gym."""
    register_policy("mine", thinnest)
    tiny_scenario.policy.name = "mine"
    tiny_scenario.horizon = 1
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    record = run_search(diagram).to_dict()
    assert record["policy"] == "mine"
    assert record["policy_source"] == f"{__name__}:thinnest"
    replay = replay_search(
        parse_scenario(record["scenario"], "record"), tiny_heap
    )
    assert replay.record.policy == "mine"
    assert replay.record.actions[0].segment == record["actions"][0]["segment"]
    tiny_scenario.scene.num_objects = 2
    (worked,) = run_rollouts(
        tiny_scenario,
        variants=[Variant("mine", "geometric", False)],
        seeds=[10_000],
        folder=tmp_path,
        workers=1,
    )
    assert worked["end"] != "error"
    assert worked["policy_source"] == f"{__name__}:thinnest"
    labels = np.array([[0, 0, 1]])
    observation = {
        "instances": labels,
        "target_mask": np.zeros(labels.shape, bool),
        "action_mask": np.ones(2, np.int8),
        "occupancy": np.zeros(labels.shape),
        "support": np.zeros(labels.shape, bool),
    }
    assert policy_agent("mine")(observation) == 1
    assert policy_agent("largest")(observation) == 0


def test_an_installed_policy_works_from_the_command_line(
    installed: Path, tmp_path: Path
) -> None:
    """In worker processes, and in the report of a machine that lacks it."""
    out = tmp_path / "out"
    program = "from xray_drake.cli.main import app; app()"
    options = (
        "benchmark --policies smallest,shelf:smallest --no-target-first "
        "--heaps 2 --seed 10000 --workers 2 --num-objects 2 --horizon 2 "
        "--occupancy geometric --out"
    )
    path = os.pathsep.join([str(installed), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", program, *options.split(), out],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = (out / "rollouts.jsonl").read_text().splitlines()
    records = sorted(map(json.loads, lines), key=lambda r: r["seed"])
    assert {r["policy"]: r["policy_source"] for r in records} == {
        "smallest": "shelf:smallest (shelf 1.2)",
        "shelf:smallest": "shelf:smallest",
    }
    assert all(record["end"] != "error" for record in records)
    one, other, *two = [[a["object"] for a in r["actions"]] for r in records]
    assert (one, two[0]) == (other, two[1])
    # Here nobody knows these policies.
    code, report, _ = answer("report", out)
    assert code == 0
    assert "smallest (geometric" in report
    assert "shelf:smallest (geometric" in report
