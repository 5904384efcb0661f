"""The tasks: possible, not trivial, and as their goals say."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.envs import registry
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.sawyer import hammer
from elast_cli.envs.sawyer.arm import SawyerTask
from elast_cli.envs.scenario import Scenario
from tests.envs.sawyer import oracles

TASKS = ("reach", "button", "drawer", "hammer")
SCENARIOS, RANDOM = 20, 10


def made(name: str, **config: object) -> SawyerTask:
    env = registry.make(name, config)
    assert isinstance(env, SawyerTask)
    return env


def scenarios(name: str) -> list[Scenario]:
    return registry.scenarios(name, "standard", seed=5, count=SCENARIOS, domain="scenario-val")


@pytest.mark.parametrize("name", TASKS)
def test_an_oracle_that_knows_the_state_succeeds(name: str) -> None:
    env, solved = made(name), 0
    for scenario in scenarios(name):
        oracle = oracles.of(name)
        env.reset(options={"scenario": scenario})
        for _ in range(env.task_info.max_steps):
            if env.step(oracle(env, scenario.goal))[4]["success"]:
                solved += 1
                break
    assert solved >= 0.95 * SCENARIOS


@pytest.mark.parametrize("name", TASKS)
def test_random_actions_rarely_succeed_and_no_start_is_solved(name: str) -> None:
    env, solved = made(name), 0
    for scenario in scenarios(name)[:RANDOM]:
        rng = np.random.default_rng(scenario.index)
        policy = RandomPolicy(env.action_size)
        policy.reset(rng)
        _, info = env.reset(options={"scenario": scenario})
        assert not info["success"]
        for _ in range(env.task_info.max_steps):
            if env.step(policy.act(rng))[4]["success"]:
                solved += 1
                break
    assert solved <= 0.1 * RANDOM + 1


def test_goals_of_the_button_have_it_pressed_by_the_hand() -> None:
    env = made("button")
    for scenario in scenarios("button"):
        assert -0.055 < scenario.goal[-1] < -0.02
        env.set_state(scenario.goal, scenario.layout)
        env.advance(np.zeros(3, dtype=np.float32))
        assert abs(env.state[-1] - scenario.goal[-1]) < 0.003  # the spring would drive it out
        assert scenario.start[-1] == 0


def test_goals_of_the_drawer_go_both_ways() -> None:
    changes = [scenario.goal[-1] - scenario.start[-1] for scenario in scenarios("drawer")]
    assert min(np.abs(changes)) >= 0.05
    assert min(changes) < 0 < max(changes)


def test_a_driven_nail_alone_is_no_success() -> None:
    env = made("hammer")
    scenario = scenarios("hammer")[0]
    nail_alone = scenario.start.copy()
    nail_alone[-1] = scenario.goal[-1]
    assert env.distance(scenario.goal, scenario.goal) == 0
    assert env.distance(nail_alone, scenario.goal) > env.success_radius


def test_a_goals_hammer_touches_the_nail() -> None:
    env = made("hammer")
    for scenario in scenarios("hammer"):
        head = hammer.head_of(scenario.goal)
        nail_head = 0.631 + scenario.goal[-1]
        assert nail_head - head[1] == pytest.approx(0.072, abs=0.012)  # half the head's length
        assert abs(head[0] - 0.24) < 0.03
        assert abs(head[2] - 0.11) < 0.03
        assert env.distance(scenario.start, scenario.goal) > env.success_radius


@pytest.mark.parametrize(
    ("name", "number", "least"), [("button", -1, 0.2), ("drawer", -1, 0.3), ("hammer", -6, 0.3)]
)
def test_random_data_move_what_matters(name: str, number: int, least: float) -> None:
    env, moved, episodes = made(name), 0, 16
    env.np_random = np.random.default_rng(0)
    for _ in range(episodes):
        env.reset(options={"collect": True})
        policy = RandomPolicy(env.action_size)
        policy.reset(env.np_random)
        seen = [env.step(policy.act(env.np_random))[4]["state"][number] for _ in range(40)]
        moved += max(seen) - min(seen) > 0.01
    assert moved >= least * episodes


def test_an_aimed_hammer_is_held_with_its_head_before_the_nail() -> None:
    env = made("hammer", held_share=0.0, aimed_share=1.0, between_share=0.0)
    rng = np.random.default_rng(0)
    for _ in range(8):
        state, _ = env.sample_start(rng)
        x, y, z = hammer.head_of(state) - (0.24, 0.631 + state[-1], 0.11)
        assert abs(x) <= 0.045
        assert abs(z) <= 0.045
        assert -0.072 - 0.085 <= y <= -0.072 + 0.005


def test_a_gripper_stays_as_it_is_until_it_is_switched() -> None:
    env = made("hammer")
    env.reset(seed=0)
    env.data.qpos[hammer.HAMMER][:2] = -0.2, 0.3  # out of the way

    def gap_after(grip: float) -> float:
        env.step(np.array([0, 0, 0.2, grip], dtype=np.float32))
        return float(np.diff(env.data.qpos[7:9])[0] + 0.07)

    for switch, wide in ((-0.6, True), (0.2, False), (-1.0, True), (1.0, False)):
        found = [gap_after(grip) for grip in (switch, switch, -0.59, 0.19, 0.0)]
        assert all((gap > 0.06) == wide for gap in found[1:])
        again = made("hammer")
        again.set_state(env.state, np.zeros(0, np.float32))  # no state is hidden
        again.advance(np.zeros(4, np.float32))
        assert (float(np.diff(again.data.qpos[7:9])[0] + 0.07) > 0.06) == wide


def test_a_closed_gripper_keeps_the_hammer() -> None:
    env = made("hammer", held_share=1.0, aimed_share=0.0, between_share=0.0)
    env.np_random = np.random.default_rng(1)
    env.reset(options={"collect": True})
    for _ in range(10):
        env.step(np.array([0, 0, 0.5, 1], dtype=np.float32))
    assert env.data.qpos[hammer.HAMMER][2] > 0.12
    for _ in range(20):
        env.step(np.array([0, 0, 0, -1], dtype=np.float32))
    assert env.data.qpos[hammer.HAMMER][2] < 0.06
