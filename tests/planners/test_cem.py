from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from elast_cli.planners.base import Plan, Query
from elast_cli.planners.cem import CemConfig, CemPlanner
from tests.toys.box import REACH, only
from tests.toys.sampling import SMALL, Drift, Exploding, cost, query


def planned(asked: Query, **config: Any) -> Plan:
    return CemPlanner(Drift(), CemConfig(**{**SMALL, **config}), 0.05).plan(asked)


def test_a_plans_states_are_what_its_actions_lead_through() -> None:
    asked = query()
    plan = planned(asked)
    assert plan.states.shape == (3, 11, 2)
    assert plan.length.tolist() == [11, 11, 11]
    z = asked.start
    for t in range(10):
        np.testing.assert_allclose(plan.states[:, t], z, atol=1e-5)
        z = z + REACH * plan.actions[:, t] + asked.context


@pytest.mark.parametrize("kind", ["summed", "terminal"])
def test_refitting_improves_on_sampling(kind: str) -> None:
    asked = query(8)
    one, many = (planned(asked, n_steps=n, cost=kind) for n in (1, 12))
    assert (cost(many, asked, kind) <= cost(one, asked, kind)).all()  # the best seen is kept
    assert cost(many, asked, kind).mean() < 0.7 * cost(one, asked, kind).mean()


def test_a_goal_within_reach_is_reached() -> None:
    asked = query(8)
    plan = planned(asked, cost="terminal", n_steps=15, num_samples=200, topk=20)
    assert plan.reached.all()
    far = replace(asked, goal=asked.goal + 50)
    assert not planned(far).reached.any()


def test_actions_stay_in_the_box() -> None:
    asked = query()
    plan = planned(replace(asked, goal=asked.goal + 50), var_scale=5.0)
    assert np.abs(plan.actions).max() == 1


def test_a_row_of_a_batch_equals_its_solo_run() -> None:
    asked = query(4)
    together = planned(asked)
    for b in range(4):
        alone = planned(only(asked, b))
        np.testing.assert_array_equal(together.states[b], alone.states[0])
        np.testing.assert_array_equal(together.actions[b], alone.actions[0])


def test_a_plan_is_a_function_of_its_seed() -> None:
    asked = query()
    np.testing.assert_array_equal(planned(asked).actions, planned(asked).actions)
    other = planned(replace(asked, seed=asked.seed + 1))
    assert not np.array_equal(planned(asked).actions, other.actions)


def test_a_warm_start_begins_with_the_actions_left() -> None:
    asked = query()
    asked = replace(asked, goal=asked.start + 9 * (REACH + asked.context))
    perfect = np.ones((3, 9, 2), np.float32)  # shorter than the horizon
    warm = replace(asked, left=perfect)
    narrow: dict[str, Any] = {"var_scale": 0.05, "n_steps": 1, "cost": "summed"}
    cold = planned(asked, **narrow)
    assert (cost(planned(warm, **narrow), asked) < cost(cold, asked)).all()
    ignored = planned(warm, **narrow, warm_start=False)
    np.testing.assert_array_equal(ignored.actions, cold.actions)
    longer = replace(asked, left=np.ones((3, 40, 2), np.float32))
    assert planned(longer).actions.shape == (3, 10, 2)


def test_every_predicted_transition_is_counted_once_a_member() -> None:
    plan = planned(query())
    assert plan.cost.transitions.tolist() == [60 * 6 * 10 * 3] * 3
    assert not plan.cost.density_calls.any()
    assert not plan.cost.policy_calls.any()


def test_where_every_rollout_overflows_the_plan_stays_and_is_not_reached() -> None:
    asked = query()
    plan = CemPlanner(Exploding(), CemConfig(**SMALL), 0.05).plan(asked)
    assert plan.states.shape == (3, 11, 2)
    np.testing.assert_array_equal(plan.states[:, -1], asked.start)
    assert not plan.actions.any()
    assert not plan.reached.any()


@pytest.mark.parametrize("bad", [{"topk": 1}, {"topk": 61, "num_samples": 60}, {"horizon": 0}])
def test_a_config_that_makes_no_sense_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        CemConfig(**bad)
