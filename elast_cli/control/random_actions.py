"""The random method: the collection policy without its privileged resets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from elast_cli.control.base import Task
from elast_cli.seeding import generator
from elast_cli.shapes import Bool, Float32, Uint8


class RandomWalk(Protocol):
    """The collection policy, as the random method needs it."""

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        ...

    def act(self, rng: np.random.Generator) -> Float32:
        """The next action [A]."""
        ...


@dataclass(frozen=True)
class Random:
    """The environment's own collection policy, without its privileged resets."""

    walks: Sequence[RandomWalk]

    def begin(self, task: Task) -> list[np.random.Generator]:
        """One generator an episode."""
        rngs = [generator("control", int(seed)) for seed in task.seed]
        for walk, rng in zip(self.walks, rngs, strict=False):
            walk.reset(rng)
        return rngs

    def act(
        self, state: list[np.random.Generator], frames: Uint8, running: Bool
    ) -> tuple[Float32, list[np.random.Generator]]:
        """A random action [B,A].

        Arguments as in `Controller.act`.
        """
        pairs = zip(self.walks, state, strict=False)
        return np.stack([walk.act(rng) for walk, rng in pairs]), state
