"""The search as a Gymnasium environment on Drake's own."""

import gc
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from pydrake.common import RandomGenerator
from pydrake.common.value import AbstractValue
from pydrake.gym import DrakeGymEnv
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import CameraConfig

from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.faults import BREAKDOWNS, one_line
from xray_drake.gym.rewards import (
    REWARDS,
    Reward,
    SearchState,
    discounted_return,
)
from xray_drake.messages import Choice, GraspOptions, InstanceMasks
from xray_drake.policy.system import PERIOD
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import SearchMonitor, begin_search
from xray_drake.search.rollout import LONGEST_ACTION
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import Scenario, load_scenario

_FIRST_SEED = 10_000
"""Seeds below are kept for acceptance and reports; a reset without a seed does
not draw them."""

_MOST_SEED = 2**31


class MechanicalSearchEnv(DrakeGymEnv):
    """Mechanical search as the paper's POMDP (section III).

    Registered as ``XRayDrake/MechanicalSearch-v0``.

    **Observation**, what the overhead camera and the perception systems say
    when the heap is at rest, a dict:

    - ``depth``: (H, W) float32, m; 0 is no reading;
    - ``target_mask``: (H, W) uint8, the target's modal mask;
    - ``instances``: (H, W) int16, −1 for the background, else the number of
      the mask, 0 the largest;
    - ``action_mask``: (n,) int8, 1 for each action that is valid; all 0 once
      the search has terminated;
    - ``occupancy``, if asked for: (H, W) float32 in [0, 1];
    - ``support``, with it: (H, W) uint8, 1 where the distribution counts.

    **Action**: the number of the mask to be grasped. The grasp on it is planned
    and executed as for every policy. A mask is *valid* if at least
    ``policy.min_visible_pixels`` are seen, and the planner has a grasp of
    ``policy.min_grasp_quality`` on it, or where no mask has that, any grasp. An
    invalid action spends one of the horizon's actions and nothing moves.
    Whether to grasp the target first is the agent's choice. ``action_masks()``
    is what sb3-contrib's MaskablePPO asks for.

    **Reward**: "sparse", "surrogate" or "visibility", see
    :mod:`xray_drake.gym.rewards`, or a function.

    **End**: terminated on success, when the target is lost, and when nothing
    is graspable (an action has to find that out, as a policy's does);
    truncated at the horizon.

    **Info**: ``valid`` (was the action), ``object`` and ``outcome`` of the
    action, ``support``, ``visible_fraction``, ``seed``, ``gamma``,
    ``discounted_return`` so far (from the start), ``end`` (empty while it
    goes on); at the end also ``record``, the rollout's record as JSON has it,
    without its wall times. What it names is ground truth: not for the agent.

    Drake's environment advances for a fixed time with each step and resets the
    context that it has. An action here lasts until the heap is at rest, and a
    reset drops another heap, which is another plant; so ``step`` and ``reset``
    are this class's own. The simulator, its ports and the rendering are
    Drake's. ``simulator`` and ``record`` are those of the heap at hand.

    Drake before 1.58, and so Python 3.11, frees no diagram with systems in
    Python: each heap leaves some 45 MB behind in its process. Take Python 3.12
    or 3.13, or have workers that start anew now and then.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["human", "rgb_array"],
        "render_fps": 1,
    }

    # Drake's own; None while there is no heap.
    simulator: Any
    action_port: Any
    observation_port: Any
    render_rgb_port: Any

    def __init__(
        self,
        scenario: Scenario | str | Path = "demo",
        *,
        reward: str | Reward = "sparse",
        gamma: float = 0.99,
        observe_occupancy: bool = False,
        drop: Callable[[Scenario], Heap] = make_heap,
        render_mode: str | None = None,
    ) -> None:
        """Reads the scenario; the first heap is dropped by ``reset``.

        Args:
            scenario: one, or its name or file; its seed, its policy's name
                and ``target_first`` are not used.
            reward: a name in ``REWARDS``, or a function like those.
            gamma: the discount factor γ of ``discounted_return``; the paper
                only says 0 < γ < 1.
            observe_occupancy: adds the distribution and its support to the
                observation.
            drop: makes the heap of a scenario: by default it is dropped, which
                takes seconds; a function that remembers heaps saves that.
            render_mode: None; "rgb_array", the camera's picture; or "human",
                in Meshcat, which says its address.

        Raises:
            ScenarioError: a scenario that cannot be used.
            ValueError: an unknown reward or render mode, or γ out of range.
        """
        if not isinstance(scenario, Scenario):
            scenario = load_scenario(scenario)
        modes = self.metadata["render_modes"]
        rewarding: Reward = (
            _one_of(REWARDS, reward, "reward")
            if isinstance(reward, str)
            else reward
        )
        if not 0 < gamma < 1:
            raise ValueError(f"gamma is {gamma}: it must be between 0 and 1")
        if render_mode is not None:
            _one_of({mode: mode for mode in modes}, render_mode, "render mode")
        number = scenario.scene.random_number
        num_actions = 1 + (
            number.most if number.mean > 0 else scenario.scene.num_objects
        )
        observation_space = _observation_space(
            scenario.camera, num_actions, with_occupancy=observe_occupancy
        )
        name = scenario.camera.name
        # Drake's constructor writes modes of its own into what it finds here.
        self.metadata = dict(self.metadata)  # type: ignore[misc]
        super().__init__(
            self._make_simulator,
            time_step=PERIOD,
            action_space=spaces.Discrete(num_actions),
            observation_space=observation_space,
            reward=lambda system, context: self._rewards[-1],
            action_port_id="search_policy.choice",
            observation_port_id=f"{name}.depth_image",
            render_rgb_port_id=f"{name}.color_image",
        )
        del self.metadata
        self.render_mode = render_mode
        self.scenario = scenario
        self.gamma = gamma
        self._reward = rewarding
        self._drop = drop
        self._meshcat = start_meshcat() if render_mode == "human" else None
        self._monitor: SearchMonitor | None = None
        self._valid = np.zeros(num_actions, np.int8)

    @property
    def monitor(self) -> SearchMonitor:
        """Of the heap at hand; its ``record`` grows with each step.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self._monitor is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._monitor

    def action_masks(self) -> np.ndarray:
        """Returns (n,) bool: which actions are valid.

        Where none is, all are True: whichever is chosen ends the search.
        """
        valid = self._valid.astype(bool)
        return valid if valid.any() else np.ones_like(valid)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Drops a heap and looks at it.

        Args:
            seed: of the heap, and of all that follows: the scenario's seed.
                Without one it is drawn, from 10,000 on.
            options: there are none.

        Raises:
            HeapError: heap after heap failed.
            ValueError: options were given, or more objects than actions.
        """
        gymnasium.Env.reset(self, seed=seed)
        if options:
            raise ValueError(f"there are no options for reset: {options}")
        if seed is None:
            seed = int(self.np_random.integers(_FIRST_SEED, _MOST_SEED))
        self._seed = seed
        self._forget()
        self.simulator = self._make_simulator(self.generator)
        self._setup()
        self.simulator.Initialize()
        self._slice = 0
        self._rewards: list[float] = []
        self._observation = self._observe()
        self._state = self._look()
        return self._answer()

    def step(
        self, action: int | np.integer
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Has a mask grasped and waits until the heap is at rest.

        A simulation that fails truncates the episode, with no reward and
        ``info["error"]``, as Drake's environment does.

        Args:
            action: number of the mask.

        Raises:
            gymnasium.error.ResetNeeded: before ``reset``, or after the end.
            gymnasium.error.InvalidAction: not in the action space.
        """
        record = self.monitor.record
        if record.end:
            raise gymnasium.error.ResetNeeded(
                f"the search has ended ({record.end}): call reset()"
            )
        if not self.action_space.contains(action):
            raise gymnasium.error.InvalidAction(
                f"no action {action!r}: choose from 0 to "
                f"{self.action_space.n - 1}"
            )
        valid = bool(self._valid[int(action)])
        name = self._names[int(action)] if valid else ""
        number = record.num_actions + 1
        self.action_port.FixValue(
            self.simulator.get_mutable_context(),
            AbstractValue.Make(Choice(number, name)),
        )
        try:
            self._advance(number)
        except BREAKDOWNS as error:
            record.end = "error"
            self._rewards.append(0.0)
            observation, info = self._answer()
            info["valid"], info["error"] = valid, one_line(error)
            return observation, 0.0, False, True, info
        before = self._state
        self._observation = self._observe()
        self._state = self._look()
        reward = float(self._reward(before, self._state))
        self._rewards.append(reward)
        truncated = record.end == "horizon"
        terminated = bool(record.end) and not truncated
        last = record.actions[-1]
        observation, info = self._answer()
        info["valid"], info["object"] = valid, last.object
        info["outcome"] = last.outcome.value
        return observation, reward, terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Shows the heap in Meshcat, or returns the (H, W, 3) uint8 picture."""
        if self.render_mode is None:
            gymnasium.logger.warn(
                "nothing is rendered: make the environment with a render_mode"
            )
            return None
        picture = super().render()
        return None if picture is None else np.array(picture)

    def close(self) -> None:
        """Forgets the heap."""
        self._forget()
        self._meshcat = None

    def _forget(self) -> None:
        self.simulator = self._monitor = None
        # Drake's own, by which the last heap's diagram would be kept.
        self.action_port = self.observation_port = self.render_rgb_port = None
        gc.collect()

    def _make_simulator(self, generator: RandomGenerator) -> Simulator:
        scenario = replace(self.scenario, seed=self._seed)
        heap = self._drop(scenario)
        if len(heap.models) > self.action_space.n:
            raise ValueError(
                f"the heap has {len(heap.models)} objects but there are "
                f"{self.action_space.n} actions: raise scene.num_objects"
            )
        if self._meshcat is not None:
            self._meshcat.Delete()
        diagram = build_search_diagram(
            scenario, heap=heap, meshcat=self._meshcat, agent=True
        )
        simulator, self._monitor = begin_search(diagram)
        return simulator

    def _advance(self, number: int) -> None:
        """Advances until an action has ended.

        It looks as often as the policy, so that the heap is seen at the moment
        at which the policy decides.
        """
        record = self.monitor.record
        for _ in range(int(LONGEST_ACTION / PERIOD)):
            self._slice += 1
            self.simulator.AdvanceTo(self._slice * PERIOD)
            if record.num_done == number:
                return
        raise RuntimeError(
            f"no end of action {number} after {LONGEST_ACTION:.0f} s of "
            f"simulated time (seed {self._seed}): a system hangs"
        )

    def _eval(self, port: str) -> Any:
        diagram: SearchDiagram = self.simulator.get_system()
        context = self.simulator.get_context()
        return diagram.GetOutputPort(port).Eval(context)

    def _observe(self) -> dict[str, np.ndarray]:
        name = self.scenario.camera.name
        depth = np.array(self._eval(f"{name}.depth_image").data[:, :, 0])
        depth[~np.isfinite(depth)] = 0.0
        mask = self._eval("target_detector.target_mask").data
        labels = self._number(self._eval("instance_segmenter.instances"))
        options = GraspOptions()
        if self.monitor.record.end in ("", "horizon"):
            options = self._eval("search_policy.options")
        valid = [name in options.valid for name in self._names]
        self._valid = np.zeros(self.action_space.n, np.int8)
        self._valid[: len(valid)] = valid[: self.action_space.n]
        observation = {
            "depth": depth,
            "target_mask": mask.astype(np.uint8),
            "instances": labels,
            "action_mask": self._valid,
        }
        if "occupancy" in self.observation_space.spaces:
            rho = self._eval("occupancy_inference.occupancy")
            observation["occupancy"] = np.array(rho.data)
            observation["support"] = rho.support().astype(np.uint8)
        return observation

    def _number(self, instances: InstanceMasks) -> np.ndarray:
        """Numbers the masks, the largest first, whatever their names."""
        areas = instances.areas()
        ranks = np.argsort(-areas, kind="stable")
        self._names = tuple(instances.names[i] for i in ranks)
        number_of = np.full(len(areas) + 1, -1, np.int16)  # −1 stays −1
        number_of[ranks] = np.arange(len(ranks))
        return number_of[instances.labels]

    def _look(self) -> SearchState:
        """Returns what the rewards look at."""
        if self.monitor.record.success:
            return SearchState(0, 1.0, success=True)
        view = self.monitor.target_view(self.simulator.get_context())
        rho = self._eval("occupancy_inference.occupancy")
        return SearchState(rho.support_size(), view.target_visible_fraction)

    def _answer(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Returns observation and info; what is given away may be changed."""
        record = self.monitor.record
        info: dict[str, Any] = {
            "seed": self._seed,
            "support": self._state.support,
            "visible_fraction": self._state.visible_fraction,
            "gamma": self.gamma,
            "discounted_return": discounted_return(self._rewards, self.gamma),
            "end": record.end,
        }
        if record.end:
            info["record"] = record.to_dict()
            for action in info["record"]["actions"]:
                del action["seconds"]
        observation = {k: v.copy() for k, v in self._observation.items()}
        return observation, info


def _one_of(table: Mapping[str, Any], name: str, what: str) -> Any:
    if name not in table:
        raise ValueError(
            f"no {what} {name!r}: choose one of {', '.join(table)}"
        )
    return table[name]


def _observation_space(
    camera: CameraConfig, num_actions: int, *, with_occupancy: bool
) -> spaces.Dict:
    shape = camera.height, camera.width
    images: dict[str, spaces.Space] = {
        "depth": spaces.Box(0.0, camera.z_far, shape, np.float32),
        "target_mask": spaces.Box(0, 1, shape, np.uint8),
        "instances": spaces.Box(-1, num_actions - 1, shape, np.int16),
        "action_mask": spaces.MultiBinary(num_actions),
    }
    if with_occupancy:
        images["occupancy"] = spaces.Box(0.0, 1.0, shape, np.float32)
        images["support"] = spaces.Box(0, 1, shape, np.uint8)
    return spaces.Dict(images)
