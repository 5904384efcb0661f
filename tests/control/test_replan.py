"""Model-predictive control: when rows plan again, and what planners are told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elast_cli.control.followers import Follower, PlayActions, TrackStates
from elast_cli.control.replan import Replan
from elast_cli.planners.base import Plan, Planner, Query
from elast_cli.seeding import derived_seed
from elast_cli.shapes import Float32, Uint8
from tests.toys.control import (
    Brightness,
    Straight,
    frames_of,
    no_context,
    task_of,
    towards,
)


def replan(planner: Planner, every: int, follower: Follower | None = None) -> Replan:
    return Replan(Brightness(), no_context, planner, follower or PlayActions(), every)


def patient(planner: Planner, every: int = 20) -> Replan:
    """Replans after two steps in a row that moved it by no more than half an action."""
    return replace(replan(planner, every, TrackStates(towards, 2)), patience=2, stall_distance=0.5)


@dataclass
class Remembering(Straight):
    """Hands every row's plan the number of plans before it as memory."""

    def plan(self, query: Query) -> Plan:
        before = [0 if item is None else item for item in query.memory]
        return replace(super().plan(query), memory=[int(str(item)) + 1 for item in before])


@dataclass
class Blocked(Remembering):
    """Finds no way for rows on their way to 9 that have failed at something."""

    def plan(self, query: Query) -> Plan:
        rows = enumerate(zip(query.goal[:, 0], query.failed, strict=True))
        blocked = [b for b, (goal, failed) in rows if goal == 9 and len(failed)]
        reached = ~np.isin(np.arange(len(query.goal)), blocked)
        return replace(super().plan(query), reached=reached, blocked=blocked)


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
        controller = replan(Straight(steps=3), 20, follower)
        state = controller.begin(task_of(9))
        for level, count in zip((1, 2, 3, 4), plans, strict=True):
            _, state = controller.act(state, frames_of(level), np.array([True]))
            assert state.log.plans.tolist() == [count]


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


def test_what_leaves_no_way_to_the_goal_is_forgotten_and_with_it_the_tree() -> None:
    planner, both = Blocked(), np.array([True, True])
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
    def pushed(images: Uint8 | None, rows: int) -> Float32:
        return np.full((rows, 1), -3, np.float32)

    controller = replace(replan(Straight(), 5, TrackStates(towards, 1)), contexts=pushed)
    action, _ = controller.act(controller.begin(task_of(20)), frames_of(1), np.array([True]))
    assert action.tolist() == [[1]]
    assert action.dtype == np.float32


def test_the_estimator_is_told_what_was_done_last_and_keeps_its_state() -> None:
    class Counting(Brightness):
        """Counts the actions that it is told of."""

        def __init__(self) -> None:
            self.told: list[list[float] | None] = []

        def update(
            self, state: Uint8 | None, frames: Uint8, last_action: Float32 | None
        ) -> tuple[Float32, Uint8 | None]:
            self.told.append(None if last_action is None else last_action.ravel().tolist())
            return super().update(state, frames, last_action)

    estimator = Counting()
    controller = replace(replan(Straight(), 20), estimator=estimator)
    state = controller.begin(task_of(9, 3))
    for levels in ((1, 2), (2, 3), (3, 3)):
        _, state = controller.act(state, frames_of(*levels), np.array([True, True]))
    assert estimator.told == [None, [1, 1], [1, 0]]
