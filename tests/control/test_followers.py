"""Followers: from plans to actions."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.control.followers import PaceStates, PlayActions, TrackStates
from tests.toys.control import column, line, plan_of, towards

NO_CONTEXT = np.zeros((1, 1), np.float32)


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


def test_each_waypoint_is_aimed_at_for_some_steps_and_then_the_goal() -> None:
    follower, route = PaceStates(towards, steps=2), line([0, 1, 2, 9], [0, 7, 7, 7], length=[4, 2])
    aims = []
    for _ in range(8):
        action, route = follower.act(
            route, column(0, 5), column(9, 7), np.zeros((2, 1), np.float32)
        )
        np.testing.assert_array_equal(action.ravel(), route.aim.ravel() - np.array([0, 5]))
        aims.append(route.aim[:, 0].tolist())
        assert not follower.spent(route).any()
    assert [aim[0] for aim in aims] == [1, 1, 2, 2, 9, 9, 9, 9]
    assert [aim[1] for aim in aims] == [7] * 8
