"""The random method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elast_cli.control.random_actions import Random
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.shapes import Float32
from tests.toys.control import task_of


def random_actions(seeds: list[int], steps: int) -> Float32:
    """Actions [T,B,A] of the random method."""
    controller = Random([RandomPolicy(2, RandomPolicyConfig()) for _ in seeds])
    rows = len(seeds)
    task = replace(task_of(*[0] * rows), seed=np.array(seeds))
    state, actions = controller.begin(task), []
    for _ in range(steps):
        action, state = controller.act(state, task.goal, np.ones(rows, bool))
        actions.append(action)
    return np.stack(actions)


def test_random_actions_depend_on_the_rows_seed_alone() -> None:
    together = random_actions([3, 5, 3], 20)
    np.testing.assert_array_equal(together, random_actions([3, 5, 3], 20))
    np.testing.assert_array_equal(together[:, 1], random_actions([5], 20)[:, 0])
    np.testing.assert_array_equal(together[:, 0], together[:, 2])
    assert not np.array_equal(together[:, 0], together[:, 1])
    assert np.abs(together).max() <= 1
