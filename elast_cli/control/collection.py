"""Random collection of one episode."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.data.dataset import Episode
from elast_cli.envs.base import FRAME_SIZE, ElastEnv
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.seeding import generator


class CollectConfig(StrictModel):
    """How much random interaction, and of what kind."""

    n: int = Field(default=50_000, gt=0, le=100_000_000, description="transitions")
    episode_steps: int = Field(default=50, gt=0, le=100_000)
    policy: RandomPolicyConfig = RandomPolicyConfig()

    @property
    def episodes(self) -> int:
        """Whole episodes that hold at least `n` transitions."""
        return -(-self.n // self.episode_steps)


def collect_episode(
    env: ElastEnv, *, seed: int, index: int, length: int, policy: RandomPolicy
) -> Episode:
    """Episode `index` of a random collection: a function of (seed, index, length, configs) alone.

    Returns:
        pixels u8 [T+1, 64, 64, 3], action f32 [T+1, A] whose last row is NaN, state f32 [T+1, S],
        with T = length; context is the environment's raw image or None.
    """
    rng = generator("collect", seed, index)
    start, layout = env.sample_start(rng)
    env.set_state(start, layout)
    policy.reset(rng)
    pixels = np.empty((length + 1, FRAME_SIZE, FRAME_SIZE, 3), dtype=np.uint8)
    action = np.full((length + 1, env.action_size), np.nan, dtype=np.float32)
    state = np.empty((length + 1, len(env.state_names)), dtype=np.float32)
    pixels[0], state[0] = env.frame(), env.state
    for t in range(length):
        action[t] = policy.act(rng)
        env.advance(action[t])
        pixels[t + 1], state[t + 1] = env.frame(), env.state
    return Episode(pixels=pixels, action=action, state=state, context=env.context, seed_index=index)
