"""Collocation: its equations against dense ones, its paths against known optima."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from elast_cli.planners.base import Query
from elast_cli.planners.collocation import (
    CollocationConfig,
    CollocationPlanner,
    linearised,
    solve_blocks,
)
from elast_cli.planners.lifted import Counted, Drafts, Problem, drafts
from elast_cli.seeding import generator
from tests.toys.dynamics import REACH, SPEED, PointMass, Unicycle, array, query


def settled(toy: Any, asked: Query, unit: float, **config: Any) -> tuple[Problem, Drafts]:
    """The drafts of the first row, when collocation is done with them."""
    settings = CollocationConfig(**{"horizon": 15, "starts": 4, **config})
    dynamics = Counted(toy.at(asked.context))
    problem = Problem(dynamics, 0, asked.start[0], asked.goal[0], unit, generator("plan", 0))
    guess = np.zeros((settings.horizon, dynamics.action_size), np.float32)
    planner = CollocationPlanner(toy.at, settings, unit)
    return problem, planner.settled(problem, drafts(problem, guess, settings))


def test_block_equations_are_solved_as_dense_ones_are() -> None:
    rng = np.random.default_rng(0)
    blocks, size = 5, 3
    wide = rng.normal(size=(blocks, size, 4 * size))
    diagonal = wide @ wide.swapaxes(1, 2)
    beside, right = rng.normal(size=(blocks - 1, size, size)), rng.normal(size=(blocks, size))
    dense = np.zeros((blocks * size, blocks * size))
    for n in range(blocks):
        at = slice(n * size, (n + 1) * size)
        dense[at, at] = diagonal[n]
        if n < blocks - 1:
            after = slice((n + 1) * size, (n + 2) * size)
            dense[at, after], dense[after, at] = beside[n], beside[n].T
    expected = np.linalg.solve(dense, right.ravel()).reshape(blocks, size)
    np.testing.assert_allclose(solve_blocks(diagonal, beside, right), expected, rtol=1e-8)
    with pytest.raises(np.linalg.LinAlgError):
        solve_blocks(-diagonal, beside, right)


@pytest.mark.parametrize(("toy", "unit"), [(PointMass(), REACH), (Unicycle(), SPEED)])
def test_constraints_hold_and_the_goal_is_met(toy: Any, unit: float) -> None:
    """The unicycle must turn and drive back and forth: the straight line breaks its dynamics."""
    asked = query(1, toy.latent_size)
    problem, done = settled(toy, asked, unit, cost="terminal")
    found = linearised(problem, done)
    assert np.abs(unit * found.defects).max() < 1e-3
    assert np.abs(found.excess).max() < 0.02
    assert np.abs(unit * done.states[:, 0] - asked.start[0]).max() < 1e-4
    assert np.abs(unit * done.states[:, -1] - asked.goal[0]).max() < 1e-2


def test_a_unicycle_goes_sideways_which_no_single_action_does() -> None:
    asked = query(1, 3)
    asked = replace(asked, start=np.zeros((1, 3), np.float32), goal=array([[0, 0.3, 0]]))
    planner = CollocationPlanner(Unicycle().at, CollocationConfig(horizon=15), SPEED)
    plan = planner.plan(asked)
    assert plan.reached.all()
    assert np.linalg.norm(plan.states[0, plan.length[0] - 1] - asked.goal[0]) < 0.03


def test_summed_costs_are_within_two_percent_of_a_straight_run_at_full_speed() -> None:
    """The optimum of z' = z + REACH a: each axis at full speed up to the goal, then rest."""
    asked = replace(query(4), context=np.zeros((4, 2), np.float32))
    asked = replace(asked, goal=asked.start + array([[6.5, -4.0]]) * REACH)
    config = CollocationConfig(horizon=12, starts=2, cost="summed")
    plan = CollocationPlanner(PointMass().at, config, REACH).plan(asked)
    steps = np.arange(1, 13)[:, None]
    optimum = np.square((np.array([6.5, 4.0]) - steps).clip(0)).sum()
    z, cost = asked.start, np.zeros(4)
    for t in range(12):
        z = z + REACH * plan.actions[:, t]
        cost += np.square((z - asked.goal) / REACH).sum(1)
    assert (cost >= optimum - 1e-3).all()
    assert (cost <= 1.02 * optimum + 0.5).all()


def test_a_multiplier_grows_while_its_constraint_is_violated_and_shrinks_after() -> None:
    """By hand: violations of ε, 9.9 ε and 0 have powers log10 of 1.1, 10 and 0.1."""
    planner = CollocationPlanner(PointMass().at, CollocationConfig(), REACH)
    found = planner._grown(np.full(3, 2.0), np.array([1e-4, 9.9e-4, 0.0]))
    np.testing.assert_allclose(found, [2 * (1 + 0.1 * np.log10(1.1)), 2.2, 1.8])
    endless = planner._grown(np.array([1e12, 2.0]), np.array([np.inf, np.nan]))
    np.testing.assert_array_equal(endless, [1e12, 2.0])  # without a warning


def test_a_draft_whose_equations_fail_is_left_and_others_go_on() -> None:
    asked = query(1)
    problem, _ = settled(PointMass(), asked, REACH, iterations=1)
    states = np.zeros((2, 16, 2))
    states[1, 5] = np.nan
    planner = CollocationPlanner(PointMass().at, CollocationConfig(horizon=15), REACH)
    with np.errstate(invalid="ignore"):
        tried = Drafts(states, np.zeros((2, 15, 2)), np.full(2, 15))
        done = planner.settled(problem, tried)
    assert np.abs(REACH * done.states[0, -1] - asked.goal[0]).max() < 1e-2
    np.testing.assert_array_equal(done.states[1], states[1])
