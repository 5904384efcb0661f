"""Gymnasium environments as a user writes them, who knows nothing of elast, and their faults."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

ID = "tests.toys.outside:Slider"
NAME = "gym-tests-toys-outside-slider"
HEIGHT, WIDTH = 48, 80


class Slider(gymnasium.Env[Any, Any]):
    """A square on a field of 48x80 pixels; the third action dims its colour.

    Actions lie in boxes of their own: ±4 and ±2 pixels a step, and 0 to 10 grey levels.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (as gymnasium)

    def __init__(self, *, render_mode: str | None = None, fault: str = "", lasts: int = 0) -> None:
        self.render_mode, self.fault, self.lasts = render_mode, fault, lasts
        self.action_space = Box(
            np.array([-4.0, -2.0, 0.0]), np.array([4.0, 2.0, 10.0]), dtype=np.float64
        )
        self.observation_space = Box(0.0, 255.0, (3,), np.float64)
        self.state = np.zeros(3)
        self.steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=None if self.fault == "forgets its seed" else seed)
        low, high = (6, 6, 0), (WIDTH - 6, HEIGHT - 6, 100)
        self.state = self.np_random.uniform(low, high)
        self.steps = 0
        return self.state.copy(), {"place": self.state.copy()}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action), action
        if self.fault == "raises" and self.steps == 3:
            raise RuntimeError("the motor\nis off")
        self.steps += 1
        moved = self.state + np.array([action[0], action[1], action[2] - 5])
        self.state = np.clip(moved, (6, 6, 0), (WIDTH - 6, HEIGHT - 6, 100))
        seen = self.state.copy()
        if self.fault == "gives NaN" and self.steps == 3:
            seen[1] = np.nan
        ends = bool(self.lasts) and self.steps >= self.lasts
        return seen, -1.0, ends, False, {"place": self.state.copy()}

    def render(self) -> Any:
        image = np.full((HEIGHT, WIDTH, 3), 230, np.uint8)
        x, y, grey = np.round(self.state).astype(int)
        image[y - 5 : y + 6, x - 5 : x + 6] = (grey, 40, 40)
        wrong = {
            "renders floats": image / 255,
            "renders grey": image[..., 0],
            "renders nothing": None,
            "renders the same": np.zeros_like(image),
        }
        return wrong.get(self.fault, image)


class Goals(Slider):
    """The same with a goal image of its own: the square in the middle; it reports success."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        start, self.state = self.state, np.array([WIDTH / 2, HEIGHT / 2, 50.0])
        self.goal, self.state = self.render(), start
        return self.state.copy(), {"goal": self.goal.copy()}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        seen, reward, ended, truncated, info = super().step(action)
        near = np.abs(self.state[:2] - (WIDTH / 2, HEIGHT / 2)).max() < 4
        return seen, reward, ended, truncated, {**info, "goal": self.goal, "is_success": near}


class Buttons(Slider):
    """Its actions are buttons."""

    def __init__(self, *, render_mode: str | None = None) -> None:
        super().__init__(render_mode=render_mode)
        self.action_space = Discrete(3)


class Unbounded(Slider):
    """Its actions have no bounds."""

    def __init__(self, *, render_mode: str | None = None) -> None:
        super().__init__(render_mode=render_mode)
        self.action_space = Box(-np.inf, np.inf, (3,), np.float64)


class Blind(Slider):
    """It draws for people only."""

    metadata = {"render_modes": ["human"], "render_fps": 10}  # noqa: RUF012 (as gymnasium)


def corner(env: gymnasium.Env[Any, Any], rng: np.random.Generator) -> Any:
    """A hook for goals: the square in the left corner, in a random line."""
    bare: Any = env.unwrapped
    bare.state = np.array([6.0, rng.uniform(6, HEIGHT - 6), 0.0])
    return env.render()


def nowhere(_env: gymnasium.Env[Any, Any], _rng: np.random.Generator) -> Any:
    """A hook that returns no image."""
    return None
