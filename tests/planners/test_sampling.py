"""What all samplers of action sequences keep, and what is each one's own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.planners.base import Plan, Query
from elast_cli.planners.cem import CemConfig, CemPlanner
from elast_cli.planners.icem import IcemConfig, IcemPlanner, coloured
from elast_cli.planners.mppi import MppiConfig, MppiPlanner
from elast_cli.planners.sampling import SamplingPlanner
from tests.toys.box import REACH, only
from tests.toys.sampling import SMALL, Drift, Exploding, cost, query

PLANNERS: dict[str, Any] = {
    "cem": (CemPlanner, CemConfig),
    "icem": (IcemPlanner, IcemConfig),
    "mppi": (MppiPlanner, MppiConfig),
}
SHARP: dict[str, Any] = {
    "cem": {"n_steps": 100, "topk": 100, "min_std": 0.01, "noise_correlation": 0.0},
    "icem": {"n_steps": 60, "topk": 50, "min_std": 0.02, "noise_beta": 1.0},
    "mppi": {"n_steps": 300, "std": 0.1, "temperature": 0.05, "noise_beta": 0.0},
}
each = pytest.mark.parametrize("name", PLANNERS)


def made(name: str, rollout: Any = None, **config: Any) -> SamplingPlanner:
    planner, settings = PLANNERS[name]
    small = {key: value for key, value in SMALL.items() if key in settings.model_fields}
    made: SamplingPlanner = planner(rollout or Drift(), settings(**{**small, **config}), 0.05)
    return made


def planned(name: str, asked: Query, **config: Any) -> Plan:
    return made(name, **config).plan(asked)


@each
def test_states_are_what_the_actions_lead_through(name: str) -> None:
    asked = query()
    plan = planned(name, asked)
    z = asked.start
    for t in range(10):
        np.testing.assert_allclose(plan.states[:, t], z, atol=1e-5)
        z = z + REACH * plan.actions[:, t] + asked.context
    assert np.abs(plan.actions).max() <= 1


@each
def test_more_iterations_never_cost_more(name: str) -> None:
    asked = query(8)
    one, many = (planned(name, asked, n_steps=n, cost="summed") for n in (1, 12))
    assert (cost(many, asked) <= cost(one, asked)).all()
    assert cost(many, asked).mean() < 0.8 * cost(one, asked).mean()


@each
def test_a_row_of_a_batch_equals_its_solo_run(name: str) -> None:
    asked = query(3)
    together = planned(name, asked)
    for b in range(3):
        np.testing.assert_array_equal(together.actions[b], planned(name, only(asked, b)).actions[0])


@each
def test_a_plan_is_a_function_of_its_seed(name: str) -> None:
    asked = query()
    np.testing.assert_array_equal(planned(name, asked).actions, planned(name, asked).actions)
    other = planned(name, replace(asked, seed=asked.seed + 1))
    assert not np.array_equal(planned(name, asked).actions, other.actions)


@each
def test_where_every_rollout_overflows_the_plan_stays(name: str) -> None:
    asked = query()
    plan = made(name, Exploding()).plan(asked)
    np.testing.assert_array_equal(plan.states[:, -1], asked.start)
    assert not plan.reached.any()


@each
def test_a_point_mass_is_driven_within_two_percent_of_the_optimum(name: str) -> None:
    """On z' = z + REACH a the least summed distance is a straight run at full speed, then rest."""
    asked = replace(query(6), context=np.zeros((6, 2), np.float32))
    asked = replace(asked, goal=asked.start + np.float32(6.5 * REACH))
    remaining = 6.5 - np.minimum(np.arange(1, 11), 6.5)
    optimum = np.sqrt(2) * REACH * remaining.sum()
    plan = planned(name, asked, cost="summed", num_samples=1000, **SHARP[name])
    assert (cost(plan, asked) <= 1.02 * optimum).all()
    assert (cost(plan, asked) >= optimum - 1e-4).all()


def test_distances_count_the_first_numbers_of_a_latent_alone() -> None:
    """With one of two axes counted, the other one's goal changes nothing."""
    asked = query()
    partly = replace(made("cem", cost="summed"), measured=1)
    plan = partly.plan(asked)
    aside = asked.goal + np.array([0, 9], np.float32)
    np.testing.assert_array_equal(plan.actions, partly.plan(replace(asked, goal=aside)).actions)
    beyond = replace(asked, goal=asked.goal + np.array([9, 0], np.float32))
    assert not np.array_equal(plan.actions, partly.plan(beyond).actions)
    near = replace(asked, goal=plan.states[:, -1] + np.array([0, 9], np.float32))
    assert partly.plan(near).reached.any()


@pytest.mark.parametrize("horizon", [1, 2, 9, 10])
@pytest.mark.parametrize("beta", [0.0, 2.0])
def test_coloured_noise_has_unit_variance_and_its_spectrum(horizon: int, beta: float) -> None:
    noise = coloured(20_000, torch.zeros(horizon, 2), beta, torch.Generator().manual_seed(0))
    assert noise.shape == (20_000, horizon, 2)
    assert float(noise.var()) == pytest.approx(1.0, abs=0.03)
    if horizon == 10:
        power = torch.fft.rfft(noise, dim=1).abs().square().mean((0, 2))
        assert float(power[1] / power[4]) == pytest.approx(4**beta, rel=0.1)


def test_icem_tries_the_actions_left_of_the_plan_before() -> None:
    asked = query()
    asked = replace(asked, goal=asked.start + 10 * (REACH + asked.context))
    perfect = np.ones((3, 10, 2), np.float32)
    warm = planned("icem", replace(asked, left=perfect), n_steps=1)
    np.testing.assert_array_equal(warm.actions, perfect)


def test_a_low_temperature_follows_the_best_sample() -> None:
    asked = query(8)
    cold, hot = (
        planned("mppi", asked, n_steps=6, temperature=t, cost="summed") for t in (0.05, 50.0)
    )
    assert cost(cold, asked).mean() < cost(hot, asked).mean()
