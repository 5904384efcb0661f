"""What tasks must satisfy whose episodes differ in a context."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from elast_cli.control.collection import collect_episode
from elast_cli.data.dataset import Dataset
from elast_cli.data.shards import compact, shard_path, write_shard
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import ENVS, EnvSpec, make_simulated, scenarios, task_info
from elast_cli.seeding import generator

each_context_env = pytest.mark.parametrize(
    "entry",
    [entry for entry in ENVS.values() if task_info(entry.name).has_context],
    ids=lambda entry: entry.name,
)


@each_context_env
def test_a_context_shows_what_an_episode_keeps_and_nothing_that_moves(entry: EnvSpec) -> None:
    env = gymnasium.make(str(entry.gym_id))
    seen = []
    for seed in range(4):
        frame, info = env.reset(seed=seed, options={"collect": True})
        context = info["context"].copy()
        assert context.shape == (64, 64, 3)
        assert context.dtype == np.uint8
        for _ in range(15):
            other = np.any(frame != context, axis=2)
            assert 0 < other.mean() < 0.25  # the agent, and all else is as in the context
            info["context"][:] = 0
            frame, *_, info = env.step(env.action_space.sample())
            assert np.array_equal(info["context"], context)
        seen.append(context.tobytes())
    assert len(set(seen)) == len(seen)


@each_context_env
def test_a_scenario_has_one_context_for_start_and_goal(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    for scenario in scenarios(entry.name, next(iter(env.levels)), seed=1, count=3):
        env.set_state(scenario.start, scenario.layout)
        at_start = env.context
        env.set_state(scenario.goal, scenario.layout)
        assert at_start is not None
        assert env.context is not None
        assert np.array_equal(at_start, env.context)


@each_context_env
def test_no_layout_is_seen_both_in_training_and_in_evaluation(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    trained = [env.sample_start(generator("collect", 0, i))[1] for i in range(1000)]
    evaluated = [
        scenario.layout
        for domain in ("scenario-val", "scenario-test")
        for scenario in scenarios(
            entry.name, next(iter(env.levels)), seed=0, count=10, domain=domain
        )
    ]
    layouts = {layout.tobytes() for layout in (*trained, *evaluated)}
    assert len(layouts) == len(trained) + len(evaluated)
    assert {layout.shape for layout in (*trained, *evaluated)} == {trained[0].shape}
    assert trained[0].dtype == np.float32


@each_context_env
def test_a_layout_of_another_shape_is_refused(entry: EnvSpec) -> None:
    env = make_simulated(entry.name)
    with pytest.raises(ValueError, match="layout"):
        env.set_state(env.state, np.zeros(3, dtype=np.float32))


@each_context_env
def test_a_collection_stores_the_context_of_every_episode(entry: EnvSpec, tmp_path: Path) -> None:
    env = make_simulated(entry.name)
    policy = RandomPolicy(env.action_size)
    shards = [shard_path(tmp_path, index) for index in range(2)]
    contexts = []
    for index, path in enumerate(shards):
        episode = collect_episode(env, seed=0, index=index, length=5, policy=policy)
        write_shard(path, [episode])
        assert episode.context is not None
        contexts.append(episode.context)
    compact(shards, tmp_path / "dataset.h5")
    stored = Dataset.load(tmp_path / "dataset.h5").context
    assert stored is not None
    assert np.array_equal(stored[:], contexts)
