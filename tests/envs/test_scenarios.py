"""What the scenarios of every simulated task must satisfy."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import ENVS, EnvSpec, make_simulated, scenarios, task_info
from elast_cli.envs.scenario import Scenario
from elast_cli.envs.simulated import SimulatedTask

each_level = pytest.mark.parametrize(
    ("entry", "level"),
    [(entry, level) for entry in ENVS.values() for level in task_info(entry.name).levels],
    ids=lambda value: value if isinstance(value, str) else value.name,
)


def same(one: Scenario, other: Scenario) -> bool:
    """Whether two scenarios are equal in every field."""
    arrays = ("start", "goal", "layout")
    rest = ("level", "index", "seed", "shortest")
    return all(np.array_equal(getattr(one, key), getattr(other, key)) for key in arrays) and all(
        getattr(one, key) == getattr(other, key) for key in rest
    )


def reaches(
    env: SimulatedTask,
    policy: RandomPolicy,
    rng: np.random.Generator,
    goal: np.ndarray,
    steps: int,
) -> bool:
    """Whether random actions come within the success radius in so many steps."""
    for _ in range(steps):
        env.advance(policy.act(rng))
        if env.distance(env.state, goal) <= env.success_radius:
            return True
    return False


@each_level
def test_scenarios_start_unsolved_and_can_be_solved(entry: EnvSpec, level: str) -> None:
    env = make_simulated(entry.name)
    rules = env.levels[level]
    for scenario in scenarios(entry.name, level, seed=0, count=20):
        _, info = env.reset(options={"scenario": scenario})
        assert not info["success"]
        assert env.distance(scenario.start, scenario.goal) > env.success_radius
        if scenario.shortest is not None:
            assert rules.min_shortest is not None
            assert rules.max_shortest is not None
            assert rules.min_shortest <= scenario.shortest <= rules.max_shortest
            assert scenario.shortest < rules.max_steps
        env.set_state(scenario.goal, scenario.layout)
        assert np.array_equal(env.frame(), info["goal"])


@each_level
def test_a_scenario_depends_on_its_index_and_not_on_the_count(entry: EnvSpec, level: str) -> None:
    few, many = (scenarios(entry.name, level, seed=6, count=count) for count in (2, 5))
    assert all(same(one, other) for one, other in zip(few, many, strict=False))
    assert not same(many[0], many[1])
    assert same(scenarios(entry.name, level, seed=6, count=1, first=3)[0], many[3])
    validation = scenarios(entry.name, level, seed=6, count=1, domain="scenario-val")
    assert not same(validation[0], few[0])


@each_level
def test_the_step_budget_is_at_most_twice_the_95th_percentile_of_shortest_steps(
    entry: EnvSpec, level: str
) -> None:
    sample = scenarios(entry.name, level, seed=0, count=100, domain="scenario-val")
    shortest = [scenario.shortest for scenario in sample if scenario.shortest is not None]
    if shortest:
        assert task_info(entry.name).level(level).max_steps <= 2 * np.percentile(shortest, 95)


@each_level
def test_random_actions_rarely_reach_the_goal(entry: EnvSpec, level: str) -> None:
    env = make_simulated(entry.name)
    policy = RandomPolicy(env.action_size)
    hits = 0
    for scenario in scenarios(entry.name, level, seed=0, count=60, domain="scenario-val"):
        env.set_state(scenario.start, scenario.layout)
        rng = np.random.default_rng(scenario.index)
        policy.reset(rng)
        hits += reaches(env, policy, rng, scenario.goal, env.levels[level].max_steps)
    assert hits <= 6
