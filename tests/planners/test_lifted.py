"""What both planners keep that optimise latents and actions together, and their drafts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from elast_cli.planners.base import Plan, Query
from elast_cli.planners.collocation import CollocationConfig, CollocationPlanner
from elast_cli.planners.gradient import GradientConfig, GradientPlanner
from elast_cli.planners.lifted import Counted, LiftedConfig, Problem, drafts, rolled_out
from elast_cli.seeding import generator
from tests.toys.box import only
from tests.toys.dynamics import REACH, Exploding, PointMass, Unicycle, array, query

PLANNERS: dict[str, Any] = {
    "collocation": (CollocationPlanner, CollocationConfig),
    "gradient": (GradientPlanner, GradientConfig),
}
SMALL: dict[str, Any] = {"horizon": 12, "starts": 3, "iterations": 15}
each = pytest.mark.parametrize("name", PLANNERS)


def planned(name: str, asked: Query, toy: Any = None, **config: Any) -> Plan:
    planner, settings = PLANNERS[name]
    dynamics = toy or PointMass()
    plan: Plan = planner(dynamics.at, settings(**{**SMALL, **config}), REACH).plan(asked)
    return plan


@each
def test_states_are_what_the_actions_lead_through_until_the_plan_ends(name: str) -> None:
    asked = query()
    plan = planned(name, asked)
    assert plan.states.shape == (3, 13, 2)
    assert np.abs(plan.actions).max() <= 1
    for b, length in enumerate(plan.length):
        z = asked.start[b]
        for t in range(length):
            np.testing.assert_allclose(plan.states[b, t], z, atol=1e-5)
            z = z + REACH * plan.actions[b, min(t, 11)] + asked.context[b]
        end = plan.states[b, length - 1]
        np.testing.assert_array_equal(plan.states[b, length:], np.tile(end, (13 - length, 1)))


@each
def test_a_goal_within_reach_is_reached_and_one_beyond_is_not(name: str) -> None:
    asked = query(4)
    assert planned(name, asked, iterations=100).reached.all()
    assert not planned(name, replace(asked, goal=asked.goal + 9)).reached.any()


@each
def test_a_row_of_a_batch_equals_its_solo_run(name: str) -> None:
    asked = query(3, 3)
    together = planned(name, asked, Unicycle())
    for b in range(3):
        alone = planned(name, only(asked, b), Unicycle())
        np.testing.assert_array_equal(together.actions[b], alone.actions[0])
        np.testing.assert_array_equal(together.states[b], alone.states[0])
        assert together.cost.transitions[b] == alone.cost.transitions[0]


@each
def test_a_plan_is_a_function_of_its_seed(name: str) -> None:
    asked = query(3, 3)
    one, same = (planned(name, asked, Unicycle()) for _ in range(2))
    np.testing.assert_array_equal(one.actions, same.actions)
    other = planned(name, replace(asked, seed=asked.seed + 1), Unicycle())
    assert not np.array_equal(one.actions, other.actions)


@each
def test_a_plan_counters_the_drift_of_its_context(name: str) -> None:
    asked = query(2)
    asked = replace(asked, goal=asked.start, context=array([[0.09, 0.0], [0.0, -0.09]]))
    plan = planned(name, asked, iterations=150, cost="summed", warm_start=False)
    first = plan.actions[:, 0]
    assert first[0, 0] < -0.2 < 0.2 < first[1, 1]


@each
def test_the_actions_left_of_a_plan_are_never_made_worse(name: str) -> None:
    asked = query()
    asked = replace(asked, goal=asked.start + 9 * (REACH + asked.context))
    left = np.ones((3, 9, 2), np.float32)  # shorter than the horizon, and perfect
    warm = planned(name, replace(asked, left=left), iterations=1)
    assert warm.length.max() <= 10
    np.testing.assert_allclose(warm.states[:, 9:], asked.goal[:, None].repeat(4, 1), atol=1e-4)
    longer = replace(asked, left=np.ones((3, 40, 2), np.float32))
    assert planned(name, longer, iterations=1).actions.shape == (3, 12, 2)


@each
def test_where_every_step_overflows_the_plan_stays_and_is_not_reached(name: str) -> None:
    asked = query()
    with np.errstate(all="ignore"):
        plan = planned(name, asked, Exploding())
    np.testing.assert_array_equal(plan.states[:, -1], asked.start)
    assert not plan.actions.any()
    assert not plan.reached.any()


def test_every_predicted_transition_is_counted_once_a_member_and_slopes_with_their_passes() -> None:
    plan = planned("gradient", query(), try_every=2, iterations=4)
    drafted, tried, each_iteration = 3, 1 + 2 * 3, 3 * (1 + (1 + 2))
    rolled_out = drafted + tried
    assert plan.cost.transitions.tolist() == [12 * 3 * (rolled_out + 4 * each_iteration)] * 3
    assert not plan.cost.density_calls.any()
    assert not plan.cost.policy_calls.any()


def test_drafts_lead_from_start_to_goal_and_break_the_dynamics_evenly() -> None:
    asked, config = query(1, 3), LiftedConfig(**{**SMALL, "starts": 4})
    dynamics = Counted(Unicycle().at(asked.context))
    problem = Problem(dynamics, 0, asked.start[0], asked.goal[0], 0.5, generator("plan", 1))
    guess = np.full((12, 2), 0.5, np.float32)
    found = drafts(problem, guess, config.model_copy(update={"cost": "terminal"}))
    assert found.states.shape == (4, 13, 3)
    assert found.arrival.tolist() == [12] * 4
    assert found.aimed.tolist() == [[False] * 12 + [True]] * 4
    np.testing.assert_allclose(0.5 * found.states[:, 0], asked.start.repeat(4, 0), atol=1e-6)
    np.testing.assert_allclose(0.5 * found.states[:, -1], asked.goal.repeat(4, 0), atol=1e-6)
    np.testing.assert_array_equal(found.actions[0], guess)
    assert not found.actions[1].any()
    steps = np.diff(found.states[1], axis=0)
    np.testing.assert_allclose(steps, np.tile(steps[0], (12, 1)), atol=1e-6)  # a straight line
    for s in (0, 2, 3):
        rolled = rolled_out(problem, found.actions[s : s + 1].astype(np.float32))[0]
        bent = np.diff(0.5 * found.states[s] - rolled, axis=0)
        np.testing.assert_allclose(bent, np.tile(bent[0], (12, 1)), atol=1e-5)
    assert np.abs(found.actions[2] - found.actions[3]).max() > 0.5


def test_drafts_arrive_at_different_steps_and_stay_at_the_goal() -> None:
    asked = query(1)
    asked = replace(asked, goal=asked.start + array([[6 * REACH, 0]]))  # of two each: three
    problem = Problem(
        Counted(PointMass().at(asked.context)),
        *(0, asked.start[0], asked.goal[0], REACH, generator("plan", 1)),
    )
    left = np.zeros((12, 2), np.float32)
    left[:5] = 1
    config = LiftedConfig(**{**SMALL, "starts": 4})
    found = drafts(problem, left, config)
    assert found.arrival.tolist() == [5, 3, 8, 12]
    for s, arrival in enumerate(found.arrival):
        gaps = np.abs(REACH * found.states[s] - asked.goal[0]).max(1)
        assert (gaps[arrival:] < 1e-5).all()
        assert (gaps[:arrival] > 1e-3).all()
    assert drafts(problem, 0 * left, config).arrival[0] == 12
    summed = config.model_copy(update={"cost": "summed"})
    assert drafts(problem, left, summed).aimed[:, 1:].all()


@each
def test_a_near_goal_is_not_approached_over_the_whole_horizon(name: str) -> None:
    asked = query(4)
    asked = replace(asked, goal=asked.start + 3 * np.float32(REACH), context=0 * asked.context)
    plan = planned(name, asked, starts=4, iterations=60)
    assert plan.reached.all()
    assert plan.length.max() < 10


@each
def test_a_start_near_the_goal_comes_nearer_and_does_not_stay(name: str) -> None:
    asked = query(4)
    asked = replace(asked, goal=asked.start + array([[0.5 * REACH, 0]]))
    plan = planned(name, asked, iterations=60)
    ends = plan.states[np.arange(4), plan.length - 1]
    assert np.linalg.norm(ends - asked.goal, axis=1).max() < 0.4 * REACH


@pytest.mark.parametrize(
    ("of", "bad"),
    [
        (CollocationConfig, {"horizon": 0}),
        (CollocationConfig, {"growth": 1.0}),
        (GradientConfig, {"learning_rate": 0}),
        (GradientConfig, {"try_every": 0}),
    ],
)
def test_a_config_that_makes_no_sense_is_refused(of: Any, bad: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        of(**bad)
