"""A world for controllers: z is how bright a picture is, and an action makes it brighter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from elast_cli.control.base import Task
from elast_cli.control.followers import Route
from elast_cli.planners.base import Plan, PlanCost, Query
from elast_cli.shapes import FRAMES, Float32, Uint8

REACH = 10  # pixels of brightness that an action of 1 adds


def towards(z: Float32, z_next: Float32, context: Float32) -> Float32:
    """The exact policy of a world where z' = z + a + c."""
    return z_next - z - context


class Brightness:
    """z [B,1]: the first pixel of the last frame, in actions, less that of the context image."""

    def begin(self, task: Task) -> tuple[Float32, Uint8 | None]:
        """Latents of the goals; the state is the context images."""
        return self.seen(task.goal, task.context), task.context

    def update(
        self, state: Uint8 | None, frames: Uint8, last_action: Float32 | None
    ) -> tuple[Float32, Uint8 | None]:
        """Latents of the frames."""
        return self.seen(frames, state), state

    def seen(self, frames: Uint8, background: Uint8 | None) -> Float32:
        """Latents of frames [B,F,64,64,3] before context images [B,64,64,3]."""
        pixel = frames[:, -1, 0, 0, :1].astype(np.float32)
        return (pixel if background is None else pixel - background[:, 0, 0, :1]) / np.float32(
            REACH
        )


def no_context(images: Uint8 | None, rows: int) -> Float32:
    """Contexts [B,1] that change nothing."""
    return np.zeros((rows, 1), np.float32)


def line(*rows: list[float], length: list[int] | None = None) -> Route:
    """Routes through one-dimensional states, one action apart."""
    states = np.array(rows, np.float32)[..., None]
    count = np.array(length or [len(rows[0])] * len(rows))
    none = np.zeros(len(rows), np.int64)
    return Route(states, np.diff(states, axis=1), count, none, states[:, 0])


def column(*values: float) -> Float32:
    """One-dimensional latents [B,1]."""
    return np.array(values, np.float32)[:, None]


def plan_of(paths: list[list[float]], *, reached: bool = True, cost: int = 1) -> Plan:
    """A plan through one-dimensional states, one list a row."""
    states = np.array(paths, np.float32)[..., None]
    rows, calls = len(paths), np.full(len(paths), cost)
    return Plan(
        states=states,
        actions=np.diff(states, axis=1),
        length=np.full(rows, states.shape[1]),
        reached=np.full(rows, reached),
        cost=PlanCost(transitions=calls, density_calls=2 * calls, policy_calls=3 * calls),
    )


@dataclass
class Straight:
    """Plans steps of 1 towards the goal, and keeps what it was asked."""

    steps: int = 20
    arrives: bool = True
    asked: list[Query] = field(default_factory=list)

    def plan(self, query: Query) -> Plan:
        """One straight path a row."""
        self.asked.append(query)
        gap = query.goal - query.start
        k = np.arange(self.steps + 1, dtype=np.float32)
        paths = query.start + np.sign(gap) * np.minimum(k, np.abs(gap))
        reached = np.full(len(gap), self.arrives)
        return replace(plan_of(paths.tolist()), reached=reached)


def frames_of(*values: int) -> Uint8:
    """Stacks of frames [B,F,64,64,3] that show z = value."""
    frames = np.zeros((len(values), FRAMES, 64, 64, 3), np.uint8)
    frames[:] = np.array(values, np.uint8)[:, None, None, None, None] * REACH
    return frames


def task_of(*goals: int) -> Task:
    """Episodes on their way to these goals."""
    return Task(frames_of(*goals), np.arange(len(goals)))
