"""An outside environment as an `ElastEnv` whose scenarios are seeds.

All that it needs of a Gymnasium environment: `reset(seed=...)`, `step`, `render` to an RGB array
and a bounded Box of actions. No state is ever set.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import gymnasium
import numpy as np

from elast_cli.envs.base import TaskInfo
from elast_cli.envs.outside.config import INFO, RANDOM, OutsideConfig
from elast_cli.envs.outside.loading import calling, load_hook
from elast_cli.envs.outside.pixels import averaged, checked
from elast_cli.envs.outside.settings import complete
from elast_cli.envs.outside.success import UNITS, Numbers, apart, compared, description, of_frame
from elast_cli.envs.outside.world import World
from elast_cli.envs.scenario import Frame, Level, Scenario, Vector
from elast_cli.errors import ConfigError, UsageError
from elast_cli.seeding import generator
from elast_cli.shapes import IMAGE_SIZE

NEAR, FAR, TASK = "near", "far", "task"
MOST_DRAWS = 100
_SEEDS = 2**31  # every random library takes seeds below this


@dataclass(frozen=True)
class _Goal:
    """A goal.

    Attributes:
        frame: u8 [64, 64, 3].
        compared: what success compares.
        state: f32 [S]; S = 0 where it is not known.
    """

    frame: Frame
    compared: Numbers
    state: Vector = field(default_factory=lambda: np.zeros(0, np.float32))


class OutsideEnv(gymnasium.Env[Frame, Vector]):
    """An outside environment. A scenario is two seeds: of the start, and of the goal.

    If the environment ends an episode, it stands still for the rest of the budget: frame, state and
    success stay as they are, and `truncated` is true.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares no ClassVar
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    def __init__(self, config: OutsideConfig, *, render_mode: str | None = None) -> None:
        """Make the environment; null settings are filled in first."""
        self.config = complete(config)
        self.render_mode = render_mode
        self.world = World(self.config)
        self._hook = load_hook(self.config.hook) if self.config.hook else None
        self._goal: _Goal | None = None  # none while collecting
        self.world.reset(0)
        self._names = tuple(self.world.named_state())
        size = self.world.action_size
        self.observation_space = gymnasium.spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (size,), np.float32)

    @property
    def levels(self) -> dict[str, Level]:
        """Levels by name: two where goals are ends of random rollouts, else one."""
        about = {TASK: "goals of the environment"}
        if self.config.goal == RANDOM:
            about = {
                NEAR: f"the goal ends {self.config.goal_steps} random steps from the start",
                FAR: "the goal ends random steps from another start",
            }
        steps = self.config.max_steps
        return {name: Level(name, steps, None, None, text) for name, text in about.items()}

    @property
    def task_info(self) -> TaskInfo:
        """Sizes, levels and success."""
        radius = self.config.success_radius
        return TaskInfo(
            action_size=self.world.action_size,
            state_names=self._names,
            has_context=False,
            levels=self.levels,
            success_radius=radius,
            unit=None if radius is None else UNITS[str(self.config.success)],
            success=description(self.config),
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Frame, dict[str, Any]]:
        """First frame and info; without options, of a random scenario of the last level.

        Raises:
            UsageError: an option or a level is unknown.
        """
        super().reset(seed=seed)
        options = options or {}
        if len(options) > 1 or not options.keys() <= {"scenario", "level", "collect"}:
            raise UsageError(f"reset options {sorted(options)}: give scenario, level or collect")
        self._goal = None
        if options.get("collect"):
            self.world.reset(_drawn(self.np_random))
        elif "scenario" in options:
            self._begin(options["scenario"])
        else:
            self.sample_scenario(options.get("level", list(self.levels)[-1]), self.np_random)
        return self.world.frame(), self._info()

    def step(self, action: Vector) -> tuple[Frame, float, bool, bool, dict[str, Any]]:
        """Frame, reward, False, whether the environment ended the episode, and info.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        reward = self.world.step(np.asarray(action, np.float32))
        return self.world.frame(), reward, False, self.world.ended, self._info()

    def render(self) -> Frame:
        """The current frame, u8 [64, 64, 3]."""
        return self.world.frame()

    def close(self) -> None:
        """Close the environment."""
        self.world.close()

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A scenario whose start is no success; its episode has begun.

        Raises:
            ConfigError: 100 draws in a row begin with success.
        """
        if level not in self.levels:
            raise UsageError(f"unknown level {level!r}: choose {' or '.join(self.levels)}")
        none = np.zeros(0, np.float32)
        for _ in range(MOST_DRAWS):
            resets = _drawn(rng), _drawn(rng)
            scenario = Scenario(none, none, level, index, seed, resets=resets)
            goal = self._begin(scenario)
            if not self._success():
                return replace(scenario, start=self.world.state, goal=goal.state)
        raise ConfigError(
            f"{self.config.id}: {MOST_DRAWS} scenarios in a row begin with success; set a smaller "
            "env.success_radius, more env.goal_steps, or another env.success"
        )

    def _begin(self, scenario: Scenario) -> _Goal:
        """Begin the episode of a scenario; returns its goal."""
        if scenario.resets is None:
            raise UsageError(f"scenario {scenario.index}: it has no seeds of resets")
        start, goal = scenario.resets
        self._goal = self._goal_of(scenario.level, start, goal)
        self.world.reset(start)
        return self._goal

    def _goal_of(self, level: str, start: int, goal: int) -> _Goal:
        """The goal of a level; `start` and `goal` are seeds."""
        world, rng = self.world, generator("goal", goal)
        if self.config.goal == RANDOM:
            for _ in world.rollout(goal if level == FAR else start, rng, self.config.goal_steps):
                pass
            return _Goal(world.frame(), compared(world), world.state)
        world.reset(start)
        if self.config.goal == INFO:
            image = world.goal_image()
            return _Goal(image, of_frame(image))
        assert self._hook is not None
        what = f"env.goal={self.config.hook}"
        with calling(self.config.id, what):
            made = self._hook(world.inner, rng)
        image = averaged(checked(made, self.config.id, f"what {what} returned"))
        return _Goal(image, of_frame(image))

    def _success(self) -> bool:
        """Whether the goal is reached now."""
        config, goal = self.config, self._goal
        assert goal is not None
        if config.success == "terminated":
            return self.world.terminated
        if config.success == "info":
            return bool(self.world.reported_success())
        assert config.success_radius is not None
        return apart(config.success, compared(self.world), goal.compared) <= config.success_radius

    def _info(self) -> dict[str, Any]:
        info: dict[str, Any] = {"state": self.world.state}
        if self._goal is not None:
            info["goal"] = self._goal.frame.copy()
            info["success"] = self._success()
        return info


def _drawn(rng: np.random.Generator) -> int:
    return int(rng.integers(_SEEDS))
