"""The episode loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from elast_cli.control.base import Controller, Task
from elast_cli.control.plan_log import PlanLog
from elast_cli.shapes import FRAMES, Float32, Int64, Uint8


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
    """One episode: when the goal was first within the radius, whether it still was at the end.

    Attributes:
        steps: steps until first success; None where it never came.
        held: within the radius at the end of the budget too.
        length: T, steps until first success or the end of the budget.
        frames: every frame u8 [T+1,64,64,3] if it was asked for.
        states: true states [T+1,S], for people.
        goal: the goal's frame u8 [64,64,3].
        plans, plan_s, reached, transitions, density_calls, policy_calls: of its planning.
        first_plan_s: the part of plan_s that the first plan took.
    """

    steps: int | None
    held: bool
    length: int
    frames: Uint8 | None
    states: Float32
    goal: Uint8
    plans: int
    plan_s: float
    first_plan_s: float
    reached: int
    transitions: int
    density_calls: int
    policy_calls: int


def run_episodes(
    controller: Controller[Any],
    envs: Sequence[Environment],
    scenarios: Sequence[Any],
    *,
    max_steps: int,
    seeds: Int64,
    keep_frames: bool = False,
) -> list[Trace]:
    """Run one episode a scenario, all side by side, each to the end of its budget.

    Success is being within the radius at any step. From then on a row no longer counts as running:
    the controller acts on, without new plans, and only whether it holds the goal is of interest.
    """
    first = [env.reset(options={"scenario": s}) for env, s in zip(envs, scenarios, strict=True)]
    told = [info for _, info in first]
    goals = np.stack([info["goal"] for info in told])
    history = [[frame] for frame, _ in first]
    states = [[info["state"]] for info in told]
    steps: list[int | None] = [None] * len(envs)
    held = [False] * len(envs)
    resting = np.repeat(goals[:, None], FRAMES, axis=1)
    task = Task(resting, seeds, context_images(told))
    state = controller.begin(task)
    for t in range(max_steps):
        running = np.array([done is None for done in steps])
        action, state = controller.act(state, _stack(history), running)
        for b, env in enumerate(envs):
            frame, _, _, _, info = env.step(action[b])
            history[b].append(frame)
            states[b].append(info["state"])
            held[b] = info["success"]
            if held[b] and steps[b] is None:
                steps[b] = t + 1
    log = getattr(state, "log", PlanLog.empty(len(envs)))
    length = [max_steps if done is None else done for done in steps]
    return [
        Trace(
            steps=steps[b],
            held=held[b],
            length=length[b],
            frames=np.stack(history[b][: length[b] + 1]) if keep_frames else None,
            states=np.stack(states[b][: length[b] + 1]),
            goal=goals[b],
            plans=int(log.plans[b]),
            plan_s=float(log.seconds[b]),
            first_plan_s=float(log.first_seconds[b]),
            reached=int(log.reached[b]),
            transitions=int(log.transitions[b]),
            density_calls=int(log.density_calls[b]),
            policy_calls=int(log.policy_calls[b]),
        )
        for b in range(len(envs))
    ]


def context_images(infos: Sequence[Mapping[str, Any]]) -> Uint8 | None:
    """Context images u8 [B,64,64,3] of what `reset` told of B episodes, if it shows them."""
    images = [info["context"] for info in infos if "context" in info]
    return np.stack(images) if images else None


def _stack(history: Sequence[Sequence[Uint8]]) -> Uint8:
    """The last F frames of each row [B,F,64,64,3]; the first frame repeats at the start."""
    back = range(-FRAMES, 0)
    return np.stack([np.stack([row[max(len(row) + i, 0)] for i in back]) for row in history])
