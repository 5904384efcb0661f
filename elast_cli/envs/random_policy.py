"""The random policy that collects data."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.envs.scenario import Vector


class RandomPolicyConfig(StrictModel):
    """How random actions are drawn: long enough in one direction to cover ground."""

    keep: float = Field(0.7, ge=0, le=1, description="chance that the last action is kept")
    noise: float = Field(0.2, ge=0, description="standard deviation added to a kept action")


class RandomPolicy:
    """The collection policy: an action is kept with noise, or drawn again from the whole box."""

    def __init__(self, action_size: int, config: RandomPolicyConfig | None = None) -> None:
        """Remember the action's size A and the configuration; call `reset` before `act`."""
        self.action_size = action_size
        self.config = config or RandomPolicyConfig()
        self._action = np.zeros(action_size)

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode with a fresh action."""
        self._action = rng.uniform(-1.0, 1.0, self.action_size)

    def act(self, rng: np.random.Generator) -> Vector:
        """The next action, f32 [A] in [-1, 1]."""
        if rng.random() < self.config.keep:
            kept = self._action + self.config.noise * rng.standard_normal(self.action_size)
            self._action = np.minimum(np.maximum(kept, -1.0), 1.0)  # np.clip takes thrice as long
        else:
            self._action = rng.uniform(-1.0, 1.0, self.action_size)
        return self._action.astype(np.float32)
