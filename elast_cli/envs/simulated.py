"""Simulated tasks: environments whose state can be set, so that scenarios can be drawn."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, SupportsFloat

import gymnasium
import numpy as np

from elast_cli.config import StrictModel
from elast_cli.envs.base import TaskInfo
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector
from elast_cli.errors import ConfigError, UsageError
from elast_cli.shapes import IMAGE_SIZE

_OPTIONS = ("scenario", "level", "collect")


class SimulatedTask(gymnasium.Env[Frame, Vector]):
    """A reaching task, an `ElastEnv`, whose state can be set.

    `step` clips the action to the box, never terminates and reports success at every step; the
    reward is 1 while successful, else 0. `reset(options=...)` takes one of {"scenario": Scenario},
    {"level": name} (drawn at random) and {"collect": True}: a random free start without a goal,
    where `info` holds neither `goal` nor `success`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by gymnasium)
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }
    state_names: ClassVar[tuple[str, ...]]
    action_size: ClassVar[int]
    levels: ClassVar[dict[str, Level]]
    unit: ClassVar[str]

    def __init__(
        self, config: StrictModel | None = None, *, render_mode: str | None = None
    ) -> None:
        """Set the spaces; an environment narrows `config` to its own class.

        `render_mode` is None or "rgb_array"; they behave alike.
        """
        self.config = config
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)
        self._began = False
        self._goal: tuple[Vector, Frame] | None = None  # none while collecting

    @property
    def task_info(self) -> TaskInfo:
        """Sizes, levels and success of this task."""
        return TaskInfo(
            action_size=self.action_size,
            state_names=self.state_names,
            has_context=self.context is not None,
            levels=self.levels,
            success_radius=self.success_radius,
            unit=self.unit,
        )

    @property
    @abstractmethod
    def success_radius(self) -> float:
        """Greatest `distance` to the goal that counts as success."""

    @property
    @abstractmethod
    def state(self) -> Vector:
        """The true state, f32 [S], a copy; for scenarios, probes, reports; never for planning."""

    @property
    def context(self) -> Frame | None:
        """A copy of the image of what is constant in an episode, None where nothing differs."""
        return None

    @abstractmethod
    def set_state(self, state: Vector, layout: Vector) -> None:
        """Set a state f32 [S] and layout f32 [L]; nothing of the old state remains."""

    @abstractmethod
    def advance(self, action: Vector) -> None:
        """Let one step of simulated time pass under an action f32 [A] inside the box."""

    @abstractmethod
    def frame(self) -> Frame:
        """A new image of the current state, u8 [64, 64, 3]."""

    @abstractmethod
    def distance(self, state: Vector, goal: Vector) -> float:
        """Distance between two states, in the unit of `success_radius`."""

    @abstractmethod
    def sample_start(self, rng: np.random.Generator) -> tuple[Vector, Vector]:
        """A random free state f32 [S] and layout f32 [L] from which to collect."""

    @abstractmethod
    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A random scenario of a level; `index` and `seed` are only noted in it."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Frame, dict[str, Any]]:
        """First frame and info of a new episode; without options a scenario of the last level.

        Raises:
            UsageError: if an option or a level is unknown.
        """
        super().reset(seed=seed)
        options = options or {}
        unknown = [key for key in options if key not in _OPTIONS]
        if unknown or len(options) > 1:
            raise UsageError(f"reset options {sorted(options)}: give one of {', '.join(_OPTIONS)}")
        self._goal = None
        if options.get("collect"):
            self.set_state(*self.sample_start(self.np_random))
        else:
            scenario = self._scenario(options)
            self.set_state(scenario.goal, scenario.layout)
            self._goal = scenario.goal.copy(), self.frame()
            self.set_state(scenario.start, scenario.layout)
        self._began = True
        return self.frame(), self._info()

    def step(self, action: Vector) -> tuple[Frame, SupportsFloat, bool, bool, dict[str, Any]]:
        """Frame, reward, False, False and info after one action, clipped to the box.

        Raises:
            ValueError: if the action has another shape or is not finite.
        """
        if not self._began:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        self.advance(self._clipped(np.asarray(action, dtype=np.float32)))
        info = self._info()
        return self.frame(), float(info.get("success", False)), False, False, info

    def render(self) -> Frame:
        """The current image, u8 [64, 64, 3]."""
        return self.frame()

    def _clipped(self, action: Vector) -> Vector:
        """The action inside the box. Raises ValueError if it makes no sense."""
        if action.shape != (self.action_size,):
            raise ValueError(f"action {action!r}: expected {self.action_size} finite numbers")
        for number in action.tolist():  # nearly always inside: `np.clip` takes ten times as long
            if not -1.0 <= number <= 1.0:
                break
        else:
            return action
        if not np.isfinite(action).all():
            raise ValueError(f"action {action!r}: expected {self.action_size} finite numbers")
        return np.clip(action, np.float32(-1), np.float32(1))

    def _scenario(self, options: dict[str, Any]) -> Scenario:
        """The scenario that the options name, or one of the level that they name."""
        if "scenario" not in options:
            return self.sample_scenario(options.get("level", list(self.levels)[-1]), self.np_random)
        scenario = options["scenario"]
        if not isinstance(scenario, Scenario):
            raise UsageError(f"reset option scenario: expected a Scenario, not {scenario!r}")
        return scenario

    def _info(self) -> dict[str, Any]:
        """Info of the current state; every array in it is the caller's own."""
        state = self.state
        info: dict[str, Any] = {"state": state}
        if self._goal is not None:
            goal, image = self._goal
            info["goal"] = image.copy()
            info["success"] = bool(self.distance(state, goal) <= self.success_radius)
        context = self.context
        if context is not None:
            info["context"] = context
        return info


class DrawLimit:
    """Bounds the number of random draws of a search."""

    def __init__(self, what: str, most: int = 100_000) -> None:
        """Remember what is looked for, and how many draws are made at most."""
        self._what, self._most, self._made = what, most, 0

    def count(self) -> None:
        """Count a draw. Raises ConfigError if it is one too many."""
        self._made += 1
        if self._made > self._most:
            raise ConfigError(
                f"no {self._what} in {self._most:,} random draws: the configuration of the "
                "environment leaves no room for one (--set env.*, or the preset's env section)"
            )
