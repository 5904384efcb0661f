"""Random collection of one episode."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.data.dataset import Episode
from elast_cli.envs.base import ElastEnv
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.seeding import generator


class CollectConfig(StrictModel):
    """How much random interaction, and of what kind."""

    n: int = Field(default=50_000, gt=0, le=100_000_000, description="transitions")
    episode_steps: int = Field(default=50, gt=0, le=100_000, description="steps of an episode")
    policy: RandomPolicyConfig = RandomPolicyConfig()

    @property
    def episodes(self) -> int:
        """Whole episodes that hold at least `n` transitions."""
        return -(-self.n // self.episode_steps)


def collect_episode(
    env: ElastEnv, *, seed: int, index: int, length: int, policy: RandomPolicy
) -> Episode:
    """Episode `index` of a random collection: a function of (seed, index, length, configs) alone.

    It ends before `length` steps if the environment ends it.

    Args:
        env: the task; its generator is replaced.
        seed: of the collection.
        index: of the episode in it.
        length: most steps.
        policy: chooses actions f32 [A].

    Returns:
        T + 1 rows with T ≤ `length`; see `Episode` for shapes and dtypes.
    """
    rng = generator("collect", seed, index)
    env.np_random = rng  # first for the start, then for the policy
    frame, info = env.reset(options={"collect": True})
    policy.reset(rng)
    pixels = np.empty((length + 1, *frame.shape), dtype=np.uint8)
    action = np.full((length + 1, policy.action_size), np.nan, dtype=np.float32)
    state = np.empty((length + 1, *info["state"].shape), dtype=np.float32)
    pixels[0], state[0] = frame, info["state"]
    rows = 1
    while rows <= length:
        command = policy.act(rng)
        frame, _, terminated, truncated, info = env.step(command)
        action[rows - 1], pixels[rows], state[rows] = command, frame, info["state"]
        rows += 1
        if terminated or truncated:
            break
    return Episode(
        pixels=pixels[:rows],
        action=action[:rows],
        state=state[:rows],
        context=info.get("context"),
        seed_index=index,
    )
