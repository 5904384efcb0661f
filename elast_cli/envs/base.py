"""The interface of environments: gymnasium's, with RGB frames and a `TaskInfo`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, SupportsFloat, runtime_checkable

import numpy as np

from elast_cli.envs.scenario import Frame, Level, Scenario, Vector
from elast_cli.errors import UsageError


@dataclass(frozen=True)
class TaskInfo:
    """The description of a task, returned by an environment instance.

    Attributes:
        action_size: size A of an action.
        state_names: names of the S numbers in `info["state"]`.
        has_context: whether `info["context"]` holds an image of what differs between episodes.
        levels: levels by name, the easiest first, each with its time limit.
        success_radius: greatest distance to the goal that counts as success, None if unknown.
        unit: unit of `success_radius`.
        success: what decides success, for tables; None in elast's own tasks.
    """

    action_size: int
    state_names: tuple[str, ...]
    has_context: bool
    levels: Mapping[str, Level]
    success_radius: float | None = None
    unit: str | None = None
    success: str | None = None

    @property
    def max_steps(self) -> int:
        """Steps of the longest level."""
        return max(level.max_steps for level in self.levels.values())

    @property
    def hardest(self) -> Level:
        """The last level."""
        return list(self.levels.values())[-1]

    def level(self, name: str) -> Level:
        """The level of that name.

        Raises:
            UsageError: naming the choices.
        """
        if name not in self.levels:
            raise UsageError(f"unknown level {name!r}: choose {' or '.join(self.levels)}")
        return self.levels[name]


class ElastEnv(Protocol):
    """A task seen through 64x64 RGB frames; actions lie in [-1, 1]^A.

    Any `gymnasium.Env` with a `task_info` can be one. All its randomness comes from `np_random`.
    `reset` takes the options {"level": name} and {"collect": True}: a random start, as in data
    collection, for which `info` need not hold a goal. An episode runs to its time limit, so that
    holding the goal can be measured: `step` reports success in `info["success"]` and never
    terminates.

    `info` holds `state` (f32 [S]), `goal` (frame u8 [64, 64, 3]), `success` and, where the task
    has one, `context` (u8 [64, 64, 3]).
    """

    np_random: np.random.Generator

    @property
    def task_info(self) -> TaskInfo:
        """Sizes, levels and success of this instance's task."""
        ...

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Frame, dict[str, Any]]:
        """First frame and info of a new episode."""
        ...

    def step(self, action: Vector, /) -> tuple[Frame, SupportsFloat, bool, bool, dict[str, Any]]:
        """Frame, reward, terminated, truncated and info after one action f32 [A]."""
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...


@runtime_checkable
class DrawsScenarios(Protocol):
    """An environment that can be evaluated: `reset` takes its scenarios as {"scenario": ...}."""

    def sample_scenario(
        self, level: str, rng: np.random.Generator, *, index: int = 0, seed: int = 0
    ) -> Scenario:
        """A random scenario of a level; `index` and `seed` are only noted in it."""
        ...
