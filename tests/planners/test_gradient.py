"""First-order lifted planning: slopes against finite differences, Adam against torch's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.planners.gradient import Adam, GradientConfig, GradientPlanner, gradient, objective
from elast_cli.planners.lifted import Counted, Drafts, Problem
from elast_cli.seeding import generator
from tests.toys.dynamics import REACH, SPEED, PointMass, Unicycle, query


@pytest.mark.parametrize("arrival", [1, 3])
@pytest.mark.parametrize(("toy", "unit"), [(PointMass(), REACH), (Unicycle(), SPEED)])
def test_slopes_of_the_objective_are_its_finite_differences(
    toy: Any, unit: float, arrival: int
) -> None:
    asked, rng = query(2, toy.latent_size), np.random.default_rng(0)
    dynamics = Counted(toy.at(asked.context))
    problem = Problem(dynamics, 1, asked.start[1], asked.goal[1], unit, generator("plan", 0))
    states = rng.normal(size=(2, 5, toy.latent_size))
    actions = rng.uniform(-1, 1, (2, 4, 2))
    config, tried = GradientConfig(), Drafts(states, actions, np.array([4, arrival]))
    by_states, by_actions = gradient(problem, tried, config)
    assert not by_states[:, 0].any()
    for x, slopes in ((states, by_states), (actions, by_actions)):
        for at in [(0, 1, 0), (1, 2, 1), (0, 3, 1), (1, len(x[0]) - 1, 0)]:
            kept, values = x[at], []
            for by in (1e-2, -1e-2):
                x[at] = kept + by
                values.append(objective(problem, tried, config)[at[0]])
            x[at] = kept
            assert (values[0] - values[1]) / 0.02 == pytest.approx(slopes[at], rel=0.02, abs=0.02)


def test_adam_is_torchs() -> None:
    rng = np.random.default_rng(0)
    own = rng.normal(size=(3, 4))
    theirs = torch.from_numpy(own.copy()).requires_grad_()
    mine, reference = Adam(own, 0.05), torch.optim.Adam([theirs], lr=0.05)
    for _ in range(20):
        slopes = rng.normal(size=(3, 4))
        mine.step(slopes)
        theirs.grad = torch.from_numpy(slopes)
        reference.step()
    np.testing.assert_allclose(own, theirs.detach().numpy(), rtol=1e-6)


def test_a_point_mass_gets_to_its_goal_and_more_iterations_get_nearer() -> None:
    asked = query(4)

    def gaps(iterations: int) -> Any:
        config = GradientConfig(horizon=12, starts=2, iterations=iterations)
        plan = GradientPlanner(PointMass().at, config, REACH).plan(asked)
        ends = plan.states[np.arange(4), plan.length - 1]
        return np.linalg.norm(ends - asked.goal, axis=1) / REACH

    few, many = gaps(5), gaps(200)
    assert many.max() < 0.5
    assert many.mean() < few.mean()


def test_drafts_depend_on_the_seed_by_their_random_actions_alone() -> None:
    asked = query(2)
    config = GradientConfig(horizon=8, starts=2, iterations=10)  # no random actions
    planner = GradientPlanner(PointMass().at, config, REACH)
    one, other = planner.plan(asked), planner.plan(replace(asked, seed=asked.seed + 1))
    np.testing.assert_array_equal(one.actions, other.actions)
