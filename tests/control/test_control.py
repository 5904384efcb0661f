from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from elast_cli.control.base import Task
from elast_cli.control.episodes import run_episodes
from elast_cli.control.followers import PlayActions, Route, TrackStates
from elast_cli.control.plan_log import PlanLog
from elast_cli.control.random_actions import Random
from elast_cli.control.replan import Replan
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.planners.base import Plan, Query
from elast_cli.seeding import derived_seed
from elast_cli.shapes import FRAMES, Float32, Uint8

REACH = 10  # pixels of brightness that an action of 1 adds


def towards(z: Float32, z_next: Float32, context: Float32) -> Float32:
    """The exact policy of a world where z' = z + a + c."""
    return z_next - z - context


def brightness(frames: Uint8, background: Uint8 | None) -> Float32:
    """z [B,1]: the first pixel of the last frame, in actions, less that of the context image."""
    pixel = frames[:, -1, 0, 0, :1].astype(np.float32)
    return (pixel if background is None else pixel - background[:, 0, 0, :1]) / np.float32(REACH)


def line(*rows: list[float], length: list[int] | None = None) -> Route:
    """Routes through one-dimensional states, one action apart."""
    states = np.array(rows, np.float32)[..., None]
    count = np.array(length or [len(rows[0])] * len(rows))
    none = np.zeros(len(rows), np.int64)
    return Route(states, np.diff(states, axis=1), count, none, states[:, 0])


def column(*values: float) -> Float32:
    return np.array(values, np.float32)[:, None]


NO_CONTEXT = np.zeros((1, 1), np.float32)


# ---- following ----------------------------------------------------------------------------------


def test_tracking_aims_one_past_the_nearest_of_the_next_waypoints() -> None:
    follower, route = TrackStates(towards, lookahead=2), line([0, 1, 2, 3, 4])
    action, route = follower.act(route, column(1.9), column(4), NO_CONTEXT)
    assert route.progress.tolist() == [2]
    assert action[0, 0] == pytest.approx(3 - 1.9)


def test_tracking_looks_no_further_than_its_window_and_never_back() -> None:
    follower, route = TrackStates(towards, lookahead=2), line([0, 1, 2, 3, 4])
    _, route = follower.act(route, column(4), column(4), NO_CONTEXT)
    assert route.progress.tolist() == [2]
    _, route = follower.act(route, column(0), column(4), NO_CONTEXT)
    assert route.progress.tolist() == [2]


def test_of_waypoints_equally_near_tracking_takes_the_last() -> None:
    action, route = TrackStates(towards, 3).act(line([5, 5, 6]), column(5), column(6), NO_CONTEXT)
    assert route.progress.tolist() == [1]
    assert action.tolist() == [[1]]


def test_tracking_notes_what_it_aims_at() -> None:
    route, context = line([0, 1, 2], [0, 1, 2]), np.zeros((2, 1), np.float32)
    _, route = TrackStates(towards, 2).act(route, column(0, 2), column(7, 7), context)
    assert route.aim.ravel().tolist() == [1, 7]


def test_past_its_last_waypoint_tracking_aims_at_the_goal() -> None:
    follower = TrackStates(towards, lookahead=3)
    route = line([0, 1, 9, 9], [0, 1, 2, 3], length=[2, 4])  # the first row is padded
    z, goal = column(1, 1), column(7, 7)
    action, route = follower.act(route, z, goal, np.zeros((2, 1), np.float32))
    assert route.progress.tolist() == [1, 1]
    assert action.ravel().tolist() == [6, 1]


def test_tracking_passes_the_context_to_the_policy() -> None:
    route = line([0, 1])
    action, _ = TrackStates(towards, 1).act(route, column(0), column(1), column(0.25))
    assert action.tolist() == [[0.75]]


def test_a_route_of_one_state_leads_straight_to_the_goal() -> None:
    action, _ = TrackStates(towards, 3).act(line([5]), column(5), column(6), NO_CONTEXT)
    assert action.tolist() == [[1]]


def test_planned_actions_are_played_in_order_and_then_nothing() -> None:
    route = line([0, 1, 3, 6], [0, 2, 2, 2], length=[4, 2])
    played = []
    for _ in range(4):
        action, route = PlayActions().act(route, column(0, 0), column(0, 0), NO_CONTEXT)
        played.append(action.ravel().tolist())
    assert played == [[1, 2], [2, 0], [3, 0], [0, 0]]


def test_playing_aims_at_the_next_state_and_past_the_end_at_the_goal() -> None:
    route, context = line([0, 1, 3], [4, 5, 5], length=[3, 2]), np.zeros((2, 1), np.float32)
    aims = []
    for _ in range(3):
        _, route = PlayActions().act(route, column(0, 0), column(7, 8), context)
        aims.append(route.aim.ravel().tolist())
    assert aims == [[1, 5], [3, 8], [7, 8]]


def test_a_route_of_one_state_has_no_action_to_play() -> None:
    route = line([5])
    for _ in range(2):
        action, route = PlayActions().act(route, column(5), column(6), NO_CONTEXT)
        assert action.tolist() == [[0]]
    assert route.actions_left().shape == (1, 0, 1)


def test_actions_left_are_those_not_played_and_zero_after_them() -> None:
    route = line([0, 1, 3, 6], [0, 2, 2, 2], length=[4, 2])
    for _ in range(2):
        _, route = PlayActions().act(route, column(0, 0), column(0, 0), NO_CONTEXT)
    assert route.actions_left()[..., 0].tolist() == [[3, 0, 0], [0, 0, 0]]


def test_new_plans_replace_some_rows_and_leave_the_others() -> None:
    route = line([0, 1, 2], [5, 6, 7])
    _, route = PlayActions().act(route, column(0, 0), column(0, 0), NO_CONTEXT)
    plan = plan_of([[8, 9, 10, 11]])
    route = route.updated(plan, np.array([1]))
    assert route.length.tolist() == [3, 4]
    assert route.progress.tolist() == [1, 0]
    assert route.states[..., 0].tolist() == [[0, 1, 2, 2], [8, 9, 10, 11]]


# ---- replanning ---------------------------------------------------------------------------------


def plan_of(paths: list[list[float]], *, reached: bool = True, cost: int = 1) -> Plan:
    """A plan through one-dimensional states, one list a row."""
    states = np.array(paths, np.float32)[..., None]
    rows, calls = len(paths), np.full(len(paths), cost)
    return Plan(
        states=states,
        actions=np.diff(states, axis=1),
        length=np.full(rows, states.shape[1]),
        reached=np.full(rows, reached),
        transitions=calls,
        density_calls=2 * calls,
        policy_calls=3 * calls,
    )


@dataclass
class Straight:
    """Plans steps of 1 towards the goal, and keeps what it was asked."""

    steps: int = 20
    arrives: bool = True
    asked: list[Query] = field(default_factory=list)

    def plan(self, query: Query) -> Plan:
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


def task_of(*goals: int, context: float = 0.0) -> Task:
    return Task(
        frames_of(*goals), np.full((len(goals), 1), context, np.float32), np.arange(len(goals))
    )


def replan(planner: Straight, every: int) -> Replan:
    return Replan(brightness, planner, PlayActions(), every)


def test_replanning_comes_every_so_many_steps_with_a_new_seed() -> None:
    planner = Straight()
    controller = replan(planner, 3)
    state = controller.begin(task_of(9, 9))
    for _ in range(7):
        _, state = controller.act(state, frames_of(1, 2), np.array([True, True]))
    assert len(planner.asked) == 3
    for index, query in enumerate(planner.asked):
        assert query.start.ravel().tolist() == [1, 2]
        assert query.goal.ravel().tolist() == [9, 9]
        assert query.seed.tolist() == [derived_seed("plan", seed, index) for seed in (0, 1)]
    assert state.log.plans.tolist() == [3, 3]


def test_only_running_rows_are_planned_for() -> None:
    planner = Straight()
    controller = replan(planner, 1)
    state = controller.begin(task_of(9, 8, 7))
    _, state = controller.act(state, frames_of(1, 2, 3), np.array([True, True, True]))
    _, state = controller.act(state, frames_of(1, 2, 3), np.array([False, True, False]))
    assert planner.asked[1].goal.tolist() == [[8]]
    assert planner.asked[1].start.tolist() == [[2]]
    assert state.log.plans.tolist() == [1, 2, 1]
    _, state = controller.act(state, frames_of(1, 2, 3), np.array([False, False, False]))
    assert len(planner.asked) == 2


def test_rows_that_never_ran_stand_still() -> None:
    controller = replan(Straight(), 5)
    state = controller.begin(task_of(9, 9))
    action, _ = controller.act(state, frames_of(1, 1), np.array([True, False]))
    assert action.ravel().tolist() == [1, 0]


def test_a_new_plan_is_told_the_actions_left_of_the_last() -> None:
    planner = Straight(steps=4)
    controller = replan(planner, 2)
    state = controller.begin(task_of(9))
    for _ in range(3):
        _, state = controller.act(state, frames_of(6), np.array([True]))
    assert planner.asked[0].left is None
    assert planner.asked[1].left is not None
    assert planner.asked[1].left[0, :, 0].tolist() == [1, 0, 0, 0]  # 1, 1 were played of 1, 1, 1, 0


def test_a_row_plans_anew_once_its_actions_are_spent_but_tracks_its_goal_after_its_states() -> None:
    for follower, plans in ((PlayActions(), [1, 1, 1, 2]), (TrackStates(towards, 1), [1] * 4)):
        controller = Replan(brightness, Straight(steps=3), follower, 20)
        state = controller.begin(task_of(9))
        for level, count in zip((1, 2, 3, 4), plans, strict=True):
            _, state = controller.act(state, frames_of(level), np.array([True]))
            assert state.log.plans.tolist() == [count]


@dataclass
class Remembering(Straight):
    """Hands every row's plan the number of plans before it as memory."""

    def plan(self, query: Query) -> Plan:
        before = [0 if item is None else item for item in query.memory]
        return replace(super().plan(query), memory=[int(str(item)) + 1 for item in before])


def patient(planner: Straight, every: int = 20) -> Replan:
    """Replans after two steps in a row that moved it by no more than half an action."""
    return Replan(brightness, planner, TrackStates(towards, 2), every, 2, 0.5)


def test_a_planner_sees_again_what_it_kept_of_each_row() -> None:
    planner = Remembering()
    controller, both = replan(planner, 1), np.array([True, True])
    state = controller.begin(task_of(9, 9))
    for running in (both, np.array([False, True]), both):
        _, state = controller.act(state, frames_of(1, 2), running)
    assert [query.memory for query in planner.asked] == [[None, None], [1], [1, 2]]


def test_a_row_that_does_not_move_replans_at_once_and_hands_on_what_failed() -> None:
    planner = Straight()
    controller, both = patient(planner), np.array([True, True])
    state = controller.begin(task_of(9, 9))
    for moving in (1, 2, 3, 4):
        _, state = controller.act(state, frames_of(5, moving), both)
    first, second = planner.asked
    assert [len(pairs) for pairs in first.failed] == [0, 0]
    assert second.start.tolist() == [[5]]  # the other row is not planned for
    assert second.seed.tolist() == [derived_seed("plan", 0, 1)]
    assert second.failed[0][..., 0].tolist() == [[5, 6]]
    assert state.log.plans.tolist() == [2, 1]
    assert [len(pairs) for pairs in state.failed] == [1, 0]


def test_what_failed_is_remembered_while_a_way_is_left() -> None:
    planner = Straight()
    controller = patient(planner)
    state = controller.begin(task_of(9))
    for level in (5, 5, 5, 6, 6, 6):
        _, state = controller.act(state, frames_of(level), np.array([True]))
    assert [query.start[0, 0] for query in planner.asked] == [5, 5, 6]
    assert planner.asked[-1].failed[0][..., 0].tolist() == [[5, 6], [6, 7]]


@dataclass
class Barred(Remembering):
    """Finds no way for rows on their way to 9 that have failed at something."""

    def plan(self, query: Query) -> Plan:
        rows = enumerate(zip(query.goal[:, 0], query.failed, strict=True))
        barred = [b for b, (goal, failed) in rows if goal == 9 and len(failed)]
        reached = ~np.isin(np.arange(len(query.goal)), barred)
        return replace(super().plan(query), reached=reached, barred=barred)


def test_what_leaves_no_way_to_the_goal_is_forgotten_and_with_it_the_tree() -> None:
    planner, both = Barred(), np.array([True, True])
    controller = patient(planner)
    state = controller.begin(task_of(8, 9))
    for _ in range(3):
        _, state = controller.act(state, frames_of(5, 6), both)
    assert [[len(x) for x in query.failed] for query in planner.asked] == [[0, 0], [1, 1], [0]]
    assert [query.memory for query in planner.asked] == [[None, None], [1, 1], [None]]
    assert planner.asked[2].start.tolist() == [[6]]
    assert planner.asked[2].seed.tolist() == [derived_seed("plan", 1, 2)]
    assert [len(pairs) for pairs in state.failed] == [1, 0]
    assert state.log.plans.tolist() == [2, 3]


def test_a_plan_that_does_not_arrive_for_other_reasons_is_made_once() -> None:
    planner = Straight(arrives=False)
    controller = patient(planner)
    state = controller.begin(task_of(9))
    for _ in range(3):
        _, state = controller.act(state, frames_of(5), np.array([True]))
    assert [len(query.failed[0]) for query in planner.asked] == [0, 1]
    assert len(state.failed[0]) == 1


def test_a_step_that_moves_starts_the_count_again() -> None:
    planner = Straight()
    controller = patient(planner)
    state = controller.begin(task_of(9))
    for level in (1, 1, 2, 2, 3, 3, 4):
        _, state = controller.act(state, frames_of(level), np.array([True]))
    assert len(planner.asked) == 1


def test_without_patience_standing_still_is_nothing_to_remark() -> None:
    planner = Straight()
    controller = replan(planner, 20)
    state = controller.begin(task_of(9))
    for _ in range(10):
        _, state = controller.act(state, frames_of(1), np.array([True]))
    assert len(planner.asked) == 1
    assert len(state.failed[0]) == 0


def test_rows_that_do_not_run_neither_stall_nor_fail() -> None:
    planner = Straight()
    controller = patient(planner)
    state = controller.begin(task_of(9, 9))
    _, state = controller.act(state, frames_of(1, 1), np.array([True, True]))
    for level in range(2, 9):
        _, state = controller.act(state, frames_of(level, 1), np.array([True, False]))
    assert len(planner.asked) == 1
    assert [len(pairs) for pairs in state.failed] == [0, 0]


def test_actions_are_clipped_to_the_box() -> None:
    controller = Replan(brightness, Straight(), TrackStates(towards, 1), 5)
    action, _ = controller.act(
        controller.begin(task_of(20, context=-3)), frames_of(1), np.array([True])
    )
    assert action.tolist() == [[1]]
    assert action.dtype == np.float32


def test_a_log_adds_up_the_plans_of_each_row() -> None:
    log = PlanLog.empty(3)
    log = log.add(plan_of([[0], [0]], cost=5), np.array([0, 2]), 4.0)
    log = log.add(plan_of([[0]], reached=False, cost=7), np.array([2]), 1.0)
    assert log.plans.tolist() == [1, 0, 2]
    assert log.seconds.tolist() == [2, 0, 3]
    assert log.reached.tolist() == [1, 0, 1]
    assert log.transitions.tolist() == [5, 0, 12]
    assert log.density_calls.tolist() == [10, 0, 24]
    assert log.policy_calls.tolist() == [15, 0, 36]
    assert PlanLog.empty(3).plans.tolist() == [0, 0, 0]


# ---- random -------------------------------------------------------------------------------------


def random_actions(seeds: list[int], steps: int) -> Float32:
    """Actions [T,B,A] of the random method."""
    controller = Random([RandomPolicy(2, RandomPolicyConfig()) for _ in seeds])
    rows = len(seeds)
    task = Task(frames_of(*[0] * rows), np.zeros((rows, 0), np.float32), np.array(seeds))
    state, actions = controller.begin(task), []
    for _ in range(steps):
        action, state = controller.act(state, task.goal, np.ones(rows, bool))
        actions.append(action)
    return np.stack(actions)


def test_random_actions_depend_on_the_rows_seed_alone() -> None:
    together = random_actions([3, 5, 3], 20)
    np.testing.assert_array_equal(together, random_actions([3, 5, 3], 20))
    np.testing.assert_array_equal(together[:, 1], random_actions([5], 20)[:, 0])
    np.testing.assert_array_equal(together[:, 0], together[:, 2])
    assert not np.array_equal(together[:, 0], together[:, 1])
    assert np.abs(together).max() <= 1


# ---- episodes -----------------------------------------------------------------------------------


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
        context=lambda infos: np.zeros((len(infos), 1), np.float32),
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
        replan(Straight(), 2),
        [Lamp(7), Lamp(2)],
        [(0, 3), (5, 4)],
        max_steps=6,
        seeds=np.arange(2),
        context=lambda infos: np.zeros((len(infos), 1), np.float32),
    )
    assert [t.steps for t in traces] == [3, 1]


def test_episodes_end_at_their_first_success_or_with_the_budget() -> None:
    planner = Straight()
    traces = run(replan(planner, 2), [(0, 3), (0, 9), (5, 4)], max_steps=6, keep_frames=True)
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
    assert [t.plans for t in traces] == [2, 3, 1]  # none after the first success
    assert [t.transitions for t in traces] == [2, 3, 1]
    assert [t.reached for t in traces] == [2, 3, 1]


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
    assert through.plans == 0  # a controller without a log has planned nothing


def test_an_episode_is_the_same_alone_and_beside_others() -> None:
    scenarios = [(0, 7), (9, 2), (3, 4)]
    together = run(replan(Straight(), 3), scenarios, max_steps=10)
    for both, scenario in zip(together, scenarios, strict=True):
        (alone,) = run(replan(Straight(), 3), [scenario], max_steps=10)
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
