"""An environment of one file and one row, as another package would bring it: a dot on a field.

It is a plain `gymnasium.Env` with a `task_info`. It draws no scenarios.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.envs.base import TaskInfo
from elast_cli.envs.registry import EnvSpec
from elast_cli.envs.scenario import Frame, Level, Vector
from elast_cli.shapes import IMAGE_SIZE

ROW = EnvSpec(
    name="dot",
    entry_point="tests.toys.dot:Dot",
    config_entry_point="tests.toys.dot:DotConfig",
    about="a dot that is moved to a place",
    gym_id="tests/Dot-v0",
    max_episode_steps=20,
)


class DotConfig(StrictModel):
    """In pixels."""

    displacement: float = Field(9.0, gt=0)
    success_radius: float = Field(4.0, gt=0)


class Dot(gymnasium.Env[Frame, Vector]):
    """State: row and column of the dot."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (as gymnasium)

    def __init__(self, config: DotConfig | None = None, *, render_mode: str | None = None) -> None:
        self.config = config or DotConfig()
        self.render_mode = render_mode
        shape = (IMAGE_SIZE, IMAGE_SIZE, 3)
        self.observation_space = gymnasium.spaces.Box(0, 255, shape, np.uint8)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.place = self.goal = np.zeros(2)

    @property
    def task_info(self) -> TaskInfo:
        level = Level("anywhere", 20, None, None, "from any place to any other")
        return TaskInfo(
            action_size=2,
            state_names=("row", "column"),
            has_context=False,
            levels={level.name: level},
            success_radius=self.config.success_radius,
            unit="pixels",
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Frame, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.goal = self.np_random.uniform(4, 60, (2, 2))
        return self.picture(self.place), self.info()

    def step(self, action: Vector) -> tuple[Frame, float, bool, bool, dict[str, Any]]:
        self.place = np.clip(self.place + self.config.displacement * action, 4, 60)
        info = self.info()
        return self.picture(self.place), float(info["success"]), False, False, info

    def render(self) -> Frame:
        return self.picture(self.place)

    def info(self) -> dict[str, Any]:
        gap = np.linalg.norm(self.place - self.goal)
        return {
            "state": self.place.astype(np.float32),
            "goal": self.picture(self.goal),
            "success": bool(gap <= self.config.success_radius),
        }

    def picture(self, place: np.ndarray) -> Frame:
        image = np.full((IMAGE_SIZE, IMAGE_SIZE, 3), 240, np.uint8)
        row, column = np.round(place).astype(int)
        image[row - 3 : row + 4, column - 3 : column + 4] = 20
        return image
