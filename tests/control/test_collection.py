"""Random collection through `reset` and `step` alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from elast_cli.control.collection import collect_episode
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.scenario import Frame, Vector
from elast_cli.seeding import generator
from tests.toys.dot import Dot


class Short(Dot):
    """An environment that ends its episodes itself, after seven steps."""

    def reset(self, **options: Any) -> tuple[Frame, dict[str, Any]]:
        self.steps = 0
        return super().reset(**options)

    def step(self, action: Vector) -> tuple[Frame, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        frame, reward, *_, info = super().step(action)
        return frame, reward, self.steps == 7, False, info


def test_start_and_actions_come_from_one_generator_in_this_order() -> None:
    env, policy = Dot(), RandomPolicy(2)
    episode = collect_episode(env, seed=3, index=5, length=4, policy=policy)
    rng = generator("collect", 3, 5)
    start = rng.uniform(4, 60, (2, 2))[0]
    policy.reset(rng)
    assert np.array_equal(episode.state[0], start.astype(np.float32))
    assert np.array_equal(episode.action[:-1], [policy.act(rng) for _ in range(4)])


def test_the_rows_of_an_episode_are_what_the_environment_showed() -> None:
    env = Dot()
    episode = collect_episode(env, seed=0, index=0, length=6, policy=RandomPolicy(2))
    env.np_random = generator("collect", 0, 0)
    frames = [env.reset(options={"collect": True})[0]]
    frames += [env.step(action)[0] for action in episode.action[:-1]]
    assert np.array_equal(episode.pixels, frames)


def test_an_episode_that_the_environment_ends_is_collected_as_far_as_it_goes() -> None:
    episode = collect_episode(Short(), seed=0, index=0, length=20, policy=RandomPolicy(2))
    assert episode.pixels.shape == (8, 64, 64, 3)
    assert episode.state.shape == (8, 2)
    assert np.isnan(episode.action).all(1).tolist() == [False] * 7 + [True]
