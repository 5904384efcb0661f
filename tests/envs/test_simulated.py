"""What every simulated task must satisfy: its state, its actions, success, documentation."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from elast_cli.config import JsonDict
from elast_cli.control.collection import collect_episode
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import ENVS, EnvSpec, make_simulated, scenarios, task_info
from elast_cli.errors import ConfigError, UsageError

ROOT = Path(__file__).parents[2]
PAGE = "docs/reference/environments/{name}.md"
each_env = pytest.mark.parametrize("entry", ENVS.values(), ids=list(ENVS))


@each_env
def test_a_collection_moves(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    policy = RandomPolicy(env.action_size)
    episodes = [collect_episode(env, seed=1, index=i, length=50, policy=policy) for i in range(20)]
    moved = [env.distance(episode.state[0], episode.state[-1]) for episode in episodes]
    assert np.mean(moved) > env.success_radius


@each_env
def test_a_collected_episode_has_no_goal(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    env.reset(seed=0)
    _, info = env.reset(options={"collect": True})
    assert not {"goal", "success"} & set(info)
    _, reward, *_, info = env.step(np.zeros(env.action_size, dtype=np.float32))
    assert not {"goal", "success"} & set(info)
    assert reward == 0


@each_env
def test_a_step_before_any_reset_is_refused(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(env.action_size, dtype=np.float32))


@each_env
def test_an_action_beyond_the_box_is_clipped(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    scenario = scenarios(entry.name, next(iter(env.levels)), seed=2, count=1)[0]
    ends = []
    for scale in (1.0, 50.0):
        env.reset(options={"scenario": scenario})
        env.step(np.full(env.action_size, scale, dtype=np.float32))
        ends.append(env.state)
    assert np.array_equal(ends[0], ends[1])


@each_env
@pytest.mark.parametrize("bad", ["nan", "short"])
def test_an_action_that_makes_no_sense_is_refused(entry: EnvSpec, bad: str) -> None:
    env = make_simulated(entry.name)
    env.reset(seed=0)
    action = np.zeros(env.action_size, dtype=np.float32)
    action = np.full_like(action, np.nan) if bad == "nan" else np.append(action, action)
    with pytest.raises(ValueError, match="finite numbers"):
        env.step(action)


@each_env
def test_setting_a_state_forgets_what_was_before(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    rng = np.random.default_rng(0)
    start, layout = env.sample_start(rng)
    actions = rng.uniform(-1, 1, (10, env.action_size)).astype(np.float32)
    seen = []
    for _ in range(2):
        env.set_state(start, layout)
        for action in actions:
            env.advance(action)
        seen.append((env.state.tobytes(), env.frame().tobytes()))
    assert seen[0] == seen[1]


@each_env
def test_success_is_reported_at_the_goal_and_rewarded(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    scenario = scenarios(entry.name, next(iter(env.levels)), seed=0, count=1)[0]
    env.reset(options={"scenario": scenario})
    env.set_state(scenario.goal, scenario.layout)
    _, reward, terminated, truncated, info = env.step(np.zeros(env.action_size, dtype=np.float32))
    assert info["success"]
    assert (reward, terminated, truncated) == (1.0, False, False)


@each_env
def test_reset_starts_where_it_is_told(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    for level in env.levels:
        assert not env.reset(seed=1, options={"level": level})[1]["success"]
    assert env.reset(seed=1, options={"collect": True})[1]["state"].shape
    for options in ({"levle": "x"}, {"level": "x"}, {"scenario": 3}):
        with pytest.raises(UsageError):
            env.reset(options=options)


@each_env
def test_the_documentation_states_budgets_and_radius(entry: EnvSpec) -> None:
    task, page = task_info(entry.name), (ROOT / PAGE.format(name=entry.name)).read_text("utf-8")
    assert f"{task.success_radius:g} {task.unit}" in page
    for level in task.levels.values():
        line = next(row for row in page.splitlines() if row.startswith(f"| `{level.name}` |"))
        assert f"| {level.max_steps} |" in line
        if level.min_shortest is not None:
            assert f"{level.min_shortest} to {level.max_shortest}" in line


@pytest.mark.parametrize(
    ("env", "settings", "words"),
    [
        ("block-s", {"half_size": 0.3}, "no free place for the block"),
        ("planar-arm", {"spacing": 0.9}, "no place for another obstacle"),
    ],
)
def test_a_workspace_without_room_is_an_error_and_no_endless_search(
    env: str, settings: JsonDict, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        make_simulated(env, settings).sample_start(np.random.default_rng(0))
