"""The collection policy."""

from __future__ import annotations

import numpy as np

from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig


def test_a_kept_action_stays_close_and_inside_the_box() -> None:
    policy = RandomPolicy(3, RandomPolicyConfig(keep=1.0, noise=0.0))
    rng = np.random.default_rng(0)
    policy.reset(rng)
    first = policy.act(rng)
    assert all(np.array_equal(first, policy.act(rng)) for _ in range(5))
    wild = RandomPolicy(3, RandomPolicyConfig(keep=1.0, noise=9.0))
    wild.reset(rng)
    assert max(np.abs(wild.act(rng)).max() for _ in range(50)) <= 1
