"""What every environment must satisfy; a new row of the table is tested without a new test.

`tests.toys.dot` shows that one file and one row make an environment.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from elast_cli.control.collection import collect_episode
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import ENVS, EnvSpec, make, register, scenarios, task_info
from tests.toys import dot

ROWS = (*ENVS.values(), dot.ROW)
DRAWING = tuple(ENVS.values())  # scenarios
each_env = pytest.mark.parametrize("entry", ROWS, ids=lambda entry: entry.name)


@pytest.fixture(autouse=True)
def _dot() -> Iterator[None]:
    """One more row, for as long as a test runs."""
    register(dot.ROW)
    yield
    del ENVS[dot.ROW.name]
    del gymnasium.registry[str(dot.ROW.gym_id)]


def made(entry: EnvSpec) -> gymnasium.Env[np.ndarray, np.ndarray]:
    """The environment by gymnasium's id."""
    return gymnasium.make(str(entry.gym_id), render_mode="rgb_array")


def policy(entry: EnvSpec) -> RandomPolicy:
    """The collection policy, its defaults."""
    return RandomPolicy(task_info(entry.name).action_size)


def rollout_digest(entry: EnvSpec) -> str:
    """Digest of an episode by gymnasium's id, a collected episode and scenarios of all levels."""
    env = made(entry)
    digest = hashlib.sha256()
    frame, info = env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(12):
        digest.update(frame.tobytes() + info["goal"].tobytes() + info["state"].tobytes())
        frame, *_, info = env.step(env.action_space.sample())
    episode = collect_episode(make(entry.name), seed=5, index=2, length=20, policy=policy(entry))
    digest.update(episode.pixels.tobytes() + episode.action.tobytes() + episode.state.tobytes())
    digest.update(b"" if episode.context is None else episode.context.tobytes())
    for level in task_info(entry.name).levels if entry in DRAWING else ():
        for scenario in scenarios(entry.name, level, seed=1, count=2):
            digest.update(scenario.start.tobytes() + scenario.goal.tobytes())
            digest.update(scenario.layout.tobytes() + repr(scenario.shortest).encode())
    return digest.hexdigest()


def digest_in_this_process(name: str) -> str:
    """The same in a process where no test has registered anything."""
    if name not in ENVS:
        register(dot.ROW)
    return rollout_digest(ENVS[name])


def expect_array(array: np.ndarray, shape: tuple[int, ...], dtype: str) -> None:
    """Assert shape and type."""
    assert array.shape == shape
    assert array.dtype == np.dtype(dtype)


@each_env
def test_gymnasium_accepts_it(entry: EnvSpec) -> None:
    check_env(made(entry).unwrapped)


@each_env
def test_stable_baselines3_accepts_it(entry: EnvSpec) -> None:
    check_env_sb3(made(entry))


@each_env
def test_it_describes_its_task(entry: EnvSpec) -> None:
    info = task_info(entry.name)
    env = made(entry)
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (info.action_size,), np.float32)
    assert env.observation_space == gymnasium.spaces.Box(0, 255, (64, 64, 3), np.uint8)
    assert len(set(info.state_names)) == len(info.state_names)
    assert all(name == level.name for name, level in info.levels.items())
    assert info.level(info.hardest.name) is info.hardest
    assert (info.success_radius is None) == (info.unit is None)
    assert entry.max_episode_steps == info.max_steps


@each_env
def test_a_seed_gives_the_same_bytes_in_another_process(entry: EnvSpec) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r})\n"
        "from tests.envs import test_conformance\n"
        f"print(test_conformance.digest_in_this_process({entry.name!r}))"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == rollout_digest(entry)


@each_env
def test_an_episode_of_a_collection_depends_on_its_index_alone(entry: EnvSpec) -> None:
    fresh, used = make(entry.name), make(entry.name)
    walk = policy(entry)
    for index in (0, 7, 1):
        collect_episode(used, seed=4, index=index, length=30, policy=walk)
    after = collect_episode(used, seed=4, index=3, length=30, policy=walk)
    alone = collect_episode(fresh, seed=4, index=3, length=30, policy=policy(entry))
    assert np.array_equal(after.pixels, alone.pixels)
    assert np.array_equal(after.state, alone.state)
    assert np.array_equal(after.action, alone.action, equal_nan=True)
    other = collect_episode(fresh, seed=4, index=4, length=30, policy=walk)
    assert not np.array_equal(other.pixels, alone.pixels)


@each_env
def test_a_collected_episode_has_the_documented_shape(entry: EnvSpec) -> None:
    info = task_info(entry.name)
    episode = collect_episode(make(entry.name), seed=0, index=9, length=25, policy=policy(entry))
    assert episode.seed_index == 9
    expect_array(episode.pixels, (26, 64, 64, 3), "uint8")
    expect_array(episode.action, (26, info.action_size), "float32")
    expect_array(episode.state, (26, len(info.state_names)), "float32")
    assert np.isnan(episode.action[-1]).all()
    assert np.abs(episode.action[:-1]).max() <= 1
    assert (episode.context is not None) == info.has_context


@each_env
def test_a_collection_covers_the_action_box(entry: EnvSpec) -> None:
    env, walk = make(entry.name), policy(entry)
    episodes = [collect_episode(env, seed=1, index=i, length=50, policy=walk) for i in range(20)]
    actions = np.concatenate([episode.action[:-1] for episode in episodes])
    assert (actions.min(0) < -0.95).all()
    assert (actions.max(0) > 0.95).all()
    assert np.abs(actions.mean(0)).max() < 0.3


@each_env
def test_info_holds_goal_success_and_state_at_every_step(entry: EnvSpec) -> None:
    env, task = made(entry), task_info(entry.name)
    frame, info = env.reset(seed=0)
    for _ in range(5):
        expect_array(frame, (64, 64, 3), "uint8")
        expect_array(info["goal"], (64, 64, 3), "uint8")
        expect_array(info["state"], (len(task.state_names),), "float32")
        assert type(info["success"]) is bool
        assert ("context" in info) == task.has_context
        frame, _, terminated, _, info = env.step(env.action_space.sample())
        assert not terminated


@each_env
def test_a_frame_belongs_to_the_caller(entry: EnvSpec) -> None:
    env = made(entry)
    frame, info = env.reset(seed=0)
    before = (frame.copy(), info["goal"].copy())
    frame[:] = 0
    info["goal"][:] = 0
    assert np.array_equal(env.render(), before[0])  # type: ignore[arg-type]  # one frame
    assert np.array_equal(env.step(0 * env.action_space.sample())[4]["goal"], before[1])


@each_env
def test_the_gymnasium_id_ends_at_the_longest_budget(entry: EnvSpec) -> None:
    env = made(entry)
    env.reset(seed=0)
    truncated, steps = False, 0
    while not truncated:
        truncated = env.step(0 * env.action_space.sample())[3]
        steps += 1
    assert steps == task_info(entry.name).max_steps
