"""The filter of beliefs and imagined rollouts are those of the model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.control.base import Task
from elast_cli.inference.rssm import BeliefFilter, BeliefRollout
from elast_cli.models.rssm.images import dequantised, quantised
from elast_cli.models.rssm.net import Rssm
from elast_cli.shapes import FRAMES
from tests.toys.models import SMALL_RSSM, models

ROWS, STEPS, ACTION = 3, 4, 2
S = SMALL_RSSM.stochastic
draws = np.random.default_rng(0)
PIXELS = draws.integers(256, size=(ROWS, STEPS, 64, 64, 3), dtype=np.uint8)
ACTIONS = draws.uniform(-1, 1, (ROWS, STEPS, ACTION)).astype(np.float32)


@pytest.fixture(scope="module")
def model() -> Rssm:
    found = models()["rssm"]
    assert isinstance(found, Rssm)
    return found


def stacked(t: int) -> Any:
    """The last frames at step t; the first one repeats at the start."""
    return PIXELS[:, np.maximum(np.arange(t - FRAMES + 1, t + 1), 0)]


def beliefs(model: Rssm) -> list[Any]:
    """Latents of an episode, step by step."""
    estimator, state, found = BeliefFilter(model), None, []
    for t in range(STEPS):
        last = None if t == 0 else ACTIONS[:, t - 1]
        z, state = estimator.update(state, stacked(t), last)
        found.append(z)
    return found


def test_beliefs_are_those_of_the_whole_sequence(model: Rssm) -> None:
    """It begins with the first frame in all places, and nothing done between them."""
    frames = np.concatenate([PIXELS[:, :1]] * (FRAMES - 1) + [PIXELS], axis=1)
    still = np.zeros((ROWS, FRAMES, ACTION), np.float32)
    action = torch.from_numpy(np.concatenate([still, ACTIONS[:, :-1]], axis=1))
    codes = quantised(torch.from_numpy(frames).flatten(0, 1)).unflatten(0, frames.shape[:2])
    expected = model.filtered(model.embed(dequantised(codes)), action)
    for t, z in enumerate(beliefs(model)):
        at = FRAMES - 1 + t
        np.testing.assert_allclose(z[:, :S], expected.posterior.mean[:, at], atol=1e-5)
        np.testing.assert_allclose(z[:, S:], expected.belief[:, at], atol=1e-5)


def test_a_goal_is_the_belief_at_rest_there(model: Rssm) -> None:
    estimator = BeliefFilter(model)
    goal, state = estimator.begin(Task(stacked(0), np.arange(ROWS)))
    assert state is None
    np.testing.assert_array_equal(goal, estimator.update(None, stacked(0), None)[0])


def test_a_row_depends_on_itself_alone_to_the_bit(model: Rssm) -> None:
    together, estimator = beliefs(model), BeliefFilter(model)
    for row in range(ROWS):
        one, state = slice(row, row + 1), None
        for t in range(STEPS):
            last = None if t == 0 else ACTIONS[one, t - 1]
            z, state = estimator.update(state, stacked(t)[one], last)
            np.testing.assert_array_equal(z[0], together[t][row])


def test_a_rollout_is_what_the_model_imagines(model: Rssm) -> None:
    rollout, z = BeliefRollout(model), torch.from_numpy(beliefs(model)[-1])
    assert (rollout.latent_size, rollout.action_size) == (z.shape[1], ACTION)
    actions = torch.from_numpy(ACTIONS)
    found = rollout(z[1], actions, torch.zeros(0))
    start = z[1].expand(ROWS, -1)
    states, hidden = model.imagined(start[:, :S], start[:, S:], actions)
    torch.testing.assert_close(found, torch.cat([states, hidden], dim=2))
