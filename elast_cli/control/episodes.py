"""The episode loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from elast_cli.control.base import Controller, Task
from elast_cli.control.plan_log import PlanLog
from elast_cli.progress import Advance, ignore
from elast_cli.shapes import FRAMES, Bool, Float32, Int64, Uint8


class Environment(Protocol):
    """What the loop needs of an environment."""

    def reset(self, *, options: dict[str, Any]) -> tuple[Uint8, dict[str, Any]]:
        """First frame and info."""
        ...

    def step(self, action: Float32) -> tuple[Uint8, Any, bool, bool, dict[str, Any]]:
        """Next frame and info."""
        ...


@dataclass(frozen=True)
class Trace:
    """One episode: when it first succeeded, and whether it held the goal to the end.

    Attributes:
        steps: steps until first success; None without success.
        held: within the radius at the end of the budget too.
        length: T, steps until first success or the end of the budget.
        frames: every frame u8 [T+1,64,64,3] if requested.
        states: true states [T+1,S], for people.
        goal: the goal's frame u8 [64,64,3].
        log: of the planning of all episodes that ran side by side.
        row: which of them this one is.
    """

    steps: int | None
    held: bool
    length: int
    frames: Uint8 | None
    states: Float32
    goal: Uint8
    log: PlanLog
    row: int


def run_episodes(
    controller: Controller[Any],
    envs: Sequence[Environment],
    scenarios: Sequence[Any],
    *,
    max_steps: int,
    seeds: Int64,
    keep_frames: bool = False,
    advance: Advance = ignore,
) -> list[Trace]:
    """Run one episode a scenario, all side by side, each to the end of its budget.

    An episode succeeds when it is within the radius at any step. Its row then no longer counts as
    running: the controller still acts, without new plans, to show whether it holds the goal.

    Args:
        controller: acts for all rows at once.
        envs: one environment a scenario.
        scenarios: start and goal of each row.
        max_steps: the budget.
        seeds: of all planning [B].
        keep_frames: whether traces have the frames.
        advance: called with the steps of running rows; a row that succeeds counts as `max_steps`.
    """
    record = _Record(
        [env.reset(options={"scenario": s}) for env, s in zip(envs, scenarios, strict=True)]
    )
    resting = np.repeat(record.goals[:, None], FRAMES, axis=1)
    state = controller.begin(Task(resting, seeds, record.context))
    counted = 0
    for t in range(max_steps):
        action, state = controller.act(state, record.stacks(), record.running())
        for b, env in enumerate(envs):
            frame, _, _, _, info = env.step(action[b])
            record.add(b, frame, info, t + 1)
        done = sum(t + 1 if steps is None else max_steps for steps in record.steps)
        advance(done - counted)
        counted = done
    return record.traces(max_steps, getattr(state, "log", None), keep_frames=keep_frames)


class _Record:
    """Frames, states and successes of B episodes that run side by side."""

    def __init__(self, first: Sequence[tuple[Uint8, dict[str, Any]]]) -> None:
        told = [info for _, info in first]
        self.goals: Uint8 = np.stack([info["goal"] for info in told])
        self.context = context_images(told)
        self.frames = [[frame] for frame, _ in first]
        self.states = [[info["state"]] for info in told]
        self.steps: list[int | None] = [None] * len(first)  # until first success
        self.held = [False] * len(first)

    def running(self) -> Bool:
        """Rows without a success [B]."""
        return np.array([steps is None for steps in self.steps])

    def stacks(self) -> Uint8:
        """The last F frames of each row [B,F,64,64,3]; the first frame repeats at the start."""
        back = range(-FRAMES, 0)
        return np.stack(
            [np.stack([row[max(len(row) + i, 0)] for i in back]) for row in self.frames]
        )

    def add(self, b: int, frame: Uint8, info: Mapping[str, Any], step: int) -> None:
        """One step of row b."""
        self.frames[b].append(frame)
        self.states[b].append(info["state"])
        self.held[b] = info["success"]
        if self.held[b] and self.steps[b] is None:
            self.steps[b] = step

    def traces(self, max_steps: int, log: PlanLog | None, *, keep_frames: bool) -> list[Trace]:
        """All rows, each up to its first success."""
        log = PlanLog.empty(len(self.steps)) if log is None else log
        length = [max_steps if steps is None else steps for steps in self.steps]
        return [
            Trace(
                steps=self.steps[b],
                held=self.held[b],
                length=length[b],
                frames=np.stack(self.frames[b][: length[b] + 1]) if keep_frames else None,
                states=np.stack(self.states[b][: length[b] + 1]),
                goal=self.goals[b],
                log=log,
                row=b,
            )
            for b in range(len(self.steps))
        ]


def context_images(infos: Sequence[Mapping[str, Any]]) -> Uint8 | None:
    """Context images u8 [B,64,64,3] of the infos of B resets, if the task has any."""
    images = [info["context"] for info in infos if "context" in info]
    return np.stack(images) if images else None
