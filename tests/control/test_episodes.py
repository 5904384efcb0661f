"""The episode loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elast_cli.control.base import Task
from elast_cli.control.episodes import run_episodes
from elast_cli.control.followers import PlayActions
from elast_cli.control.replan import Replan
from elast_cli.shapes import Float32, Uint8
from tests.toys.control import REACH, Brightness, Straight, column, no_context


def replan(every: int) -> Replan:
    return Replan(Brightness(), no_context, Straight(), PlayActions(), every)


@dataclass
class Dimmer:
    """A picture that an action makes brighter; a scenario is (start, goal) in actions."""

    level: int = 0
    goal: int = 0
    seen: list[float] = field(default_factory=list)

    def picture(self, level: int) -> Uint8:
        return np.full((64, 64, 3), level * REACH, np.uint8)

    def told(self) -> dict[str, Any]:
        return {"state": column(self.level)[0], "success": self.level == self.goal}

    def reset(self, *, options: dict[str, Any]) -> tuple[Uint8, dict[str, Any]]:
        self.level, self.goal = options["scenario"]
        return self.picture(self.level), {**self.told(), "goal": self.picture(self.goal)}

    def step(self, action: Float32) -> tuple[Uint8, Any, bool, bool, dict[str, Any]]:
        self.seen.append(float(action[0]))
        self.level = int(np.clip(self.level + round(float(action[0])), 0, 25))
        return self.picture(self.level), 0.0, False, False, self.told()


def run(controller: Any, scenarios: list[tuple[int, int]], **options: Any) -> list[Any]:
    envs = [Dimmer() for _ in scenarios]
    rows = len(scenarios)
    return run_episodes(
        controller,
        envs,
        scenarios,
        seeds=np.arange(rows),
        **options,
    )


class Lamp(Dimmer):
    """A dimmer before a background of its own, which its context image shows."""

    def __init__(self, background: int) -> None:
        super().__init__()
        self.background = background

    def picture(self, level: int) -> Uint8:
        return super().picture(level + self.background)

    def reset(self, *, options: dict[str, Any]) -> tuple[Uint8, dict[str, Any]]:
        frame, info = super().reset(options=options)
        return frame, {**info, "context": super().picture(self.background)}


def test_the_estimator_is_given_every_rows_context_image() -> None:
    traces = run_episodes(
        replan(2),
        [Lamp(7), Lamp(2)],
        [(0, 3), (5, 4)],
        max_steps=6,
        seeds=np.arange(2),
    )
    assert [t.steps for t in traces] == [3, 1]


def test_episodes_end_at_their_first_success_or_with_the_budget() -> None:
    traces = run(replan(2), [(0, 3), (0, 9), (5, 4)], max_steps=6, keep_frames=True)
    assert [t.steps for t in traces] == [3, None, 1]
    assert [t.length for t in traces] == [3, 6, 1]
    assert [t.states[:, 0].tolist() for t in traces] == [
        [0, 1, 2, 3],
        [0, 1, 2, 3, 4, 5, 6],
        [5, 4],
    ]
    assert [t.frames[:, 0, 0, 0].tolist() for t in traces] == [
        (t.states[:, 0] * REACH).tolist() for t in traces
    ]
    assert [t.goal[0, 0, 0] for t in traces] == [30, 90, 40]
    assert [int(t.log.plans[t.row]) for t in traces] == [2, 3, 1]  # none after the first success
    assert [int(t.log.cost.transitions[t.row]) for t in traces] == [2, 3, 1]
    assert [int(t.log.reached[t.row]) for t in traces] == [2, 3, 1]


def test_a_goal_that_is_left_again_counts_but_is_not_held() -> None:
    class Up:
        def begin(self, task: Task) -> int:
            return len(task.goal)

        def act(self, state: int, frames: Uint8, running: Any) -> tuple[Float32, int]:
            return np.ones((state, 1), np.float32), state

    through, at_the_end = run(Up(), [(0, 2), (0, 5)], max_steps=5)
    assert (through.steps, through.held) == (2, False)
    assert (at_the_end.steps, at_the_end.held) == (5, True)
    assert through.frames is None
    assert through.log.plans.tolist() == [0, 0]  # a controller without a log has planned nothing


def test_an_episode_is_the_same_alone_and_beside_others() -> None:
    scenarios = [(0, 7), (9, 2), (3, 4)]
    together = run(replan(3), scenarios, max_steps=10)
    for both, scenario in zip(together, scenarios, strict=True):
        (alone,) = run(replan(3), [scenario], max_steps=10)
        assert (alone.steps, alone.length) == (both.steps, both.length)
        np.testing.assert_array_equal(alone.states, both.states)


def test_the_controller_sees_the_last_frames_and_a_goal_at_rest() -> None:
    seen: list[Uint8] = []
    goals: list[Uint8] = []

    class Watching:
        def begin(self, task: Task) -> None:
            goals.append(task.goal[0, :, 0, 0, 0])

        def act(self, state: None, frames: Uint8, running: Any) -> tuple[Float32, None]:
            seen.append(frames[0, :, 0, 0, 0])
            return np.ones((1, 1), np.float32), None

    run(Watching(), [(1, 20)], max_steps=4)
    assert [frames.tolist() for frames in goals] == [[200, 200, 200]]
    assert [frames.tolist() for frames in seen] == [
        [10, 10, 10],
        [10, 10, 20],
        [10, 20, 30],
        [20, 30, 40],
    ]


def test_progress_counts_the_steps_of_running_rows_and_the_rest_at_success() -> None:
    counted: list[int] = []
    run(replan(20), [(0, 2), (0, 9), (5, 4)], max_steps=4, advance=counted.append)
    assert counted == [1 + 1 + 4, 3 + 1 + 0, 0 + 1 + 0, 0 + 1 + 0]
    assert sum(counted) == 3 * 4
