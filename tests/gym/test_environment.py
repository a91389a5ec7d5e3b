"""The environment on the tiny heap, which is not dropped."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pydrake.gym import DrakeGymEnv
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from tests.search.watching import stripped
from xray_drake.grasping.evidence.model import ModelPlannerConfig
from xray_drake.gym import ENV_ID
from xray_drake.gym.agents import policy_agent, random_agent, xray_agent
from xray_drake.gym.environment import MechanicalSearchEnv
from xray_drake.gym.rewards import (
    SearchState,
    discounted_return,
    sparse,
    surrogate,
    visibility,
)
from xray_drake.scene.heap import Heap, HeapError
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario

TARGET = "box_2to1"
GAMMA = 0.9
Step = tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]


def play(
    env: gymnasium.Env, agent: Callable[..., int], seed: int
) -> tuple[dict[str, np.ndarray], dict[str, Any], list[Step]]:
    """Returns the first observation and info, and all steps to the end."""
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=seed)
    first = observation, info
    steps: list[Step] = []
    done = False
    while not done:
        assert observation in env.observation_space
        steps.append(env.step(agent(observation, rng)))
        observation, _, terminated, truncated, _ = steps[-1]
        done = terminated or truncated
    return *first, steps


def without_scores(record: dict[str, Any]) -> dict[str, Any]:
    """What an agent has not, is left out."""
    actions = [
        {k: v for k, v in action.items() if k not in ("score", "ranking")}
        for action in record["actions"]
    ]
    return {**record, "policy": "", "actions": actions}


@pytest.fixture
def quick(tiny_scenario: Scenario) -> Scenario:
    """For what does not depend on how good a grasp or an image is."""
    camera = tiny_scenario.camera
    camera.width, camera.height = 128, 96
    camera.center_x, camera.center_y, camera.focal.x = 63.5, 47.5, 138.0
    tiny_scenario.policy.min_visible_pixels = 5
    tiny_scenario.scene.num_objects = 2
    tiny_scenario.gripper.planner = ModelPlannerConfig(
        jaw_samples=100,
        suction_samples=40,
        suction_turns=2,
        max_candidates=100,
        enough=1,
        rehearsals=0,
    )
    return tiny_scenario


@pytest.fixture
def pair(tiny_heap: Heap) -> Heap:
    """The target under the book and its pad: soon dropped and searched."""
    objects = (o for o in tiny_heap.objects if o.name in ("book", "pad"))
    return replace(tiny_heap, objects=tuple(objects))


def test_xray_as_an_agent_does_what_the_policy_does(
    tiny_heap: Heap, tiny_scenario: Scenario
) -> None:
    """Rewarded by the surrogate; observations and rewards say what is seen."""
    record = run_search(build_search_diagram(tiny_scenario, heap=tiny_heap))
    env = gymnasium.make(
        ENV_ID,
        scenario=replace(tiny_scenario, seed=99),  # not reset's
        reward="surrogate",
        gamma=GAMMA,
        observe_occupancy=True,
        drop=lambda scenario: tiny_heap,
    )
    assert isinstance(env.unwrapped, DrakeGymEnv)
    agent = policy_agent("xray", target_first=False)
    first, start, steps = play(env, agent, seed=7)
    mine = steps[-1][-1]["record"]
    assert mine["policy"] == "agent"
    assert without_scores(mine) == without_scores(stripped(record))
    assert [s[2:4] for s in steps[:-1]] == [(False, False)] * (len(steps) - 1)
    assert steps[-1][2:4] == (True, False)
    assert steps[-1][-1]["end"] == "success"
    check_rewards(start, steps)
    check_what_is_observed(first, steps)


def check_rewards(start: dict[str, Any], steps: list[Step]) -> None:
    actions = steps[-1][-1]["record"]["actions"]
    rewards = [reward for _, reward, *_ in steps]
    assert rewards == [
        a["support_before"] - a["support_after"] for a in actions
    ]
    assert start["support"] == actions[0]["support_before"]
    assert start["discounted_return"] == 0
    for k, (*_, info) in enumerate(steps):
        assert info["gamma"] == GAMMA
        assert info["object"] == actions[k]["object"]
        expected = sum(GAMMA**i * r for i, r in enumerate(rewards[: k + 1]))
        assert info["discounted_return"] == pytest.approx(expected)
        assert ("record" in info) == (k == len(steps) - 1)
    seen = [
        info["visible_fraction"] for info in (start, *(s[4] for s in steps))
    ]
    assert seen[:-1] == pytest.approx(
        [a["target_visible_fraction"] for a in actions], abs=1e-4
    )
    assert seen[-1] == 1


def check_what_is_observed(
    first: dict[str, np.ndarray], steps: list[Step]
) -> None:
    labels, mask = first["instances"], first["target_mask"].astype(bool)
    areas = np.bincount(labels[labels >= 0])
    assert (np.diff(areas) <= 0).all()  # the largest first
    assert len(np.unique(labels[mask])) == 1
    assert first["depth"].dtype == np.float32
    assert 0.7 < np.median(first["depth"]) < 0.81
    assert first["occupancy"].max() == 1
    np.testing.assert_array_equal(first["support"], first["occupancy"] > 0)
    valid = np.flatnonzero(first["action_mask"])
    assert set(valid) <= set(range(len(areas)))
    # An object that was taken away is not seen any more.
    assert steps[0][-1]["object"] == "book"
    assert steps[0][0]["target_mask"].sum() > 5 * mask.sum()


def test_a_search_that_has_ended_needs_a_reset(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    """And an invalid action spends one of the horizon's."""
    tiny_scenario.horizon = 2
    env = MechanicalSearchEnv(
        tiny_scenario, drop=lambda scenario: tiny_heap, render_mode="rgb_array"
    )
    # Drake's own modes have not got in.
    modes = MechanicalSearchEnv.metadata["render_modes"]
    assert modes == env.metadata["render_modes"] == ["human", "rgb_array"]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    before, info = env.reset(seed=7)
    picture = env.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((384, 512, 3), np.uint8)
    invalid = int(env.action_space.n) - 1
    masks = env.action_masks()
    assert masks.dtype == bool
    assert masks.tolist() == before["action_mask"].astype(bool).tolist()
    assert not masks[invalid]
    for outside in (-1, invalid + 1):
        with pytest.raises(gymnasium.error.InvalidAction, match="from 0 to 4"):
            env.step(outside)
    after, reward, terminated, truncated, info = env.step(invalid)
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert (info["valid"], info["object"]) == (False, "")
    assert info["outcome"] == "no_grasp"
    for key, value in before.items():
        np.testing.assert_array_equal(after[key], value)
    after["depth"][:] = 0  # what is given away may be changed
    *_, terminated, truncated, info = env.step(invalid)
    assert (terminated, truncated) == (False, True)
    assert info["end"] == info["record"]["end"] == "horizon"
    assert info["record"]["num_actions"] == 2
    assert "others have" in info["record"]["actions"][0]["reason"]
    with pytest.raises(gymnasium.error.ResetNeeded, match="horizon"):
        env.step(0)


def test_nothing_graspable_ends_it(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    tiny_scenario.cell.gripper.parameters = {
        "force": 1e-6,
        "vacuum_force": 1e-6,
    }
    env = MechanicalSearchEnv(tiny_scenario, drop=lambda scenario: tiny_heap)
    observation, _ = env.reset(seed=7)
    assert not observation["action_mask"].any()
    assert env.action_masks().all()  # or a masked policy has nothing to draw
    action = random_agent(observation, np.random.default_rng(0))
    *_, terminated, truncated, info = env.step(action)
    assert (terminated, truncated) == (True, False)
    assert info["end"] == "nothing_graspable"


def test_a_random_agent_to_the_end_and_again(
    quick: Scenario, pair: Heap
) -> None:
    env = MechanicalSearchEnv(
        quick, reward="sparse", drop=lambda scenario: pair
    )
    one, other = (play(env, random_agent, seed=3) for _ in range(2))
    assert len(one[2]) == len(other[2]) <= 10
    for a, b in zip(one[2], other[2], strict=True):
        assert a[1:] == b[1:]
        for key in a[0]:
            np.testing.assert_array_equal(a[0][key], b[0][key])
    rewards = [step[1] for step in one[2]]
    success = one[2][-1][-1]["end"] == "success"
    assert rewards == [0.0] * (len(rewards) - 1) + [float(success)]
    assert all(step[-1]["valid"] for step in one[2])


def test_a_simulation_that_fails_truncates(
    quick: Scenario, pair: Heap, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = MechanicalSearchEnv(quick, drop=lambda scenario: pair)
    before, _ = env.reset(seed=7)
    monkeypatch.setattr("xray_drake.gym.environment.LONGEST_ACTION", 0.1)
    after, reward, terminated, truncated, info = env.step(0)
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert "seed 7" in info["error"]
    assert info["end"] == "error"
    np.testing.assert_array_equal(after["depth"], before["depth"])


def test_the_seed_of_the_heap(tiny_scenario: Scenario) -> None:
    seeds: list[int] = []

    def drop(scenario: Scenario) -> Heap:
        seeds.append(scenario.seed)
        raise HeapError("not today")

    env = MechanicalSearchEnv(tiny_scenario, drop=drop)
    for seed in (5, None, None, 5, None):
        with pytest.raises(HeapError, match="not today"):
            env.reset(seed=seed)
    assert seeds[0] == seeds[3] == 5
    assert seeds[1] == seeds[4] != seeds[2]
    assert min(seeds[1], seeds[2]) >= 10_000  # the others are for reports
    assert tiny_scenario.seed == 7


def test_a_heap_of_more_objects_than_actions(tiny_heap: Heap) -> None:
    few = Scenario()
    few.scene.num_objects = 2
    env = MechanicalSearchEnv(few, drop=lambda scenario: tiny_heap)
    with pytest.raises(ValueError, match="no options"):
        env.reset(options={"heap": 3})
    with pytest.raises(ValueError, match="5 objects but there are 3 actions"):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"reward": "fame"}, "sparse, surrogate, visibility"),
        ({"gamma": 1.0}, "gamma is 1.0"),
        ({"render_mode": "ansi"}, "human, rgb_array"),
        ({"scenario": "nowhere"}, "no scenario 'nowhere'"),
    ],
)
def test_what_cannot_be_made(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MechanicalSearchEnv(**settings)


def test_rewards() -> None:
    before, after = SearchState(900, 0.25), SearchState(400, 0.75)
    lifted = SearchState(0, 1.0, success=True)
    assert (sparse(before, after), sparse(after, lifted)) == (0, 1)
    assert (surrogate(before, after), surrogate(after, before)) == (500, -500)
    assert visibility(before, after) == 0.5
    assert visibility(after, lifted) == 0.25
    assert discounted_return([1, 2, 4], 0.5) == 3
    assert discounted_return([], 0.5) == 0


def test_agents() -> None:
    labels = np.full((4, 6), -1, np.int16)
    labels[:2], labels[2, :3], labels[3, 3:] = 0, 1, 2
    rho = np.full((4, 6), 0.1, np.float32)
    rho[2, :2] = 0.5
    rho[0, 0] = 0.3

    def seen(*valid: int) -> dict[str, np.ndarray]:
        return {
            "instances": labels,
            "occupancy": rho,
            # A network's answer is faint where it is no support.
            "support": (rho > 0.2).astype(np.uint8),
            "target_mask": (labels == 2).astype(np.uint8),
            "action_mask": np.isin(np.arange(4), valid).astype(np.int8),
        }

    assert rho[labels == 0].sum() > rho[labels == 1].sum()
    assert xray_agent(seen(0, 1)) == 1
    assert xray_agent(seen(0)) == 0
    assert xray_agent(seen(0, 1, 2)) == 2  # the target first
    assert policy_agent("xray", target_first=False)(seen(0, 1, 2)) == 1
    rng = np.random.default_rng(0)
    assert {random_agent(seen(0, 1, 2), rng) for _ in range(50)} == {0, 1, 2}
    assert xray_agent(seen()) == random_agent(seen(), rng) == 0


# Images of one channel that are no bytes: it says that its own CNN policies
# need to be given an extractor.
@pytest.mark.filterwarnings("ignore:Your observation .* unconventional shape")
@pytest.mark.parametrize("check", [check_env, sb3_check_env])
def test_checkers_of_gymnasium_and_stable_baselines(
    quick: Scenario, pair: Heap, check: Callable[[gymnasium.Env], None]
) -> None:
    env = gymnasium.make(ENV_ID, scenario=quick, drop=lambda scenario: pair)
    check(env.unwrapped)
