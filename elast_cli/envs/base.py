"""What every environment offers the tool: one gymnasium class, scenarios, and random collection."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, SupportsFloat

import gymnasium
import numpy as np

from elast_cli.config import StrictModel
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector
from elast_cli.errors import ConfigError, UsageError

FRAME_SIZE = 64


class ElastEnv(gymnasium.Env[Frame, Vector]):
    """A reaching task seen through 64x64 RGB frames; actions lie in [-1, 1]^A.

    `step` clips the action to the box, never terminates (an episode runs to its time limit) and
    reports success at every step in `info["success"]`; the reward is 1 while successful, else 0.
    `info` also holds `goal` (frame u8 [64, 64, 3]), `state` (f32 [S]) and, where the environment
    has one, `context` (u8 image).

    `reset(options=...)` takes one of {"scenario": Scenario}, {"level": name} (drawn at random) and
    {"collect": True}: a random free start as in data collection, where the goal has no meaning and
    shows the start.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by gymnasium)
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }
    state_names: ClassVar[tuple[str, ...]]
    action_size: ClassVar[int]
    levels: ClassVar[dict[str, Level]]

    def __init__(
        self, config: StrictModel | None = None, *, render_mode: str | None = None
    ) -> None:
        """Set the spaces; an environment narrows `config` to its own class.

        `render_mode` is None or "rgb_array"; they behave alike.
        """
        self.config = config
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(0, 255, (FRAME_SIZE, FRAME_SIZE, 3), np.uint8)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)
        self._goal: Vector | None = None
        self._goal_frame: Frame | None = None

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
        """Raw image of what is constant in an episode, None where no two episodes differ in it."""
        return None

    @abstractmethod
    def set_state(self, state: Vector, layout: Vector) -> None:
        """Put the world into a state f32 [S] and layout f32 [L], forgetting what was before."""

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
        scenario = self._scenario(options or {})
        self.set_state(scenario.goal, scenario.layout)
        self._goal, self._goal_frame = scenario.goal.copy(), self.frame()
        self.set_state(scenario.start, scenario.layout)
        return self.frame(), self._info()

    def step(self, action: Vector) -> tuple[Frame, SupportsFloat, bool, bool, dict[str, Any]]:
        """Frame, reward, False, False and info after one action, clipped to the box.

        Raises:
            ValueError: if the action has another shape or is not finite.
        """
        command = np.asarray(action, dtype=np.float32)
        if command.shape != (self.action_size,) or not np.isfinite(command).all():
            raise ValueError(f"action {action!r}: expected {self.action_size} finite numbers")
        self.advance(np.clip(command, np.float32(-1), np.float32(1)))
        info = self._info()
        return self.frame(), float(info["success"]), False, False, info

    @classmethod
    def level(cls, name: str) -> Level:
        """The level of that name.

        Raises:
            UsageError: naming the choices.
        """
        if name not in cls.levels:
            raise UsageError(f"unknown level {name!r}: choose {' or '.join(cls.levels)}")
        return cls.levels[name]

    def render(self) -> Frame:
        """The current image, u8 [64, 64, 3]."""
        return self.frame()

    def _scenario(self, options: Mapping[str, Any]) -> Scenario:
        known = ("scenario", "level", "collect")
        unknown = [key for key in options if key not in known]
        if unknown or len(options) > 1:
            raise UsageError(f"reset options {sorted(options)}: give one of {', '.join(known)}")
        if "scenario" in options:
            scenario = options["scenario"]
            if not isinstance(scenario, Scenario):
                raise UsageError(f"reset option scenario: expected a Scenario, not {scenario!r}")
            return scenario
        if options.get("collect"):
            return self._free_scenario(self.np_random)
        return self.sample_scenario(options.get("level", list(self.levels)[-1]), self.np_random)

    def _free_scenario(self, rng: np.random.Generator) -> Scenario:
        start, layout = self.sample_start(rng)
        return Scenario(
            start=start, goal=start.copy(), level="collect", index=0, seed=0, layout=layout
        )

    def _info(self) -> dict[str, Any]:
        if self._goal is None or self._goal_frame is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        state = self.state
        info: dict[str, Any] = {
            "goal": self._goal_frame.copy(),
            "success": bool(self.distance(state, self._goal) <= self.success_radius),
            "state": state,
        }
        if self.context is not None:
            info["context"] = self.context
        return info


class Draws:
    """Counts random draws in search of something, so that no search goes on for ever."""

    def __init__(self, what: str, most: int = 100_000) -> None:
        """Remember what is looked for, and how many draws are made at most."""
        self._what, self._most, self._made = what, most, 0

    def count(self) -> None:
        """Another draw begins. Raises ConfigError: it is one too many."""
        self._made += 1
        if self._made > self._most:
            raise ConfigError(
                f"no {self._what} in {self._most:,} random draws: the configuration of the "
                "environment leaves no room for one (--set env.*, or the preset's env section)"
            )
