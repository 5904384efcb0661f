"""The policy on images: what it sees, random shifts, and what it learns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.models.goal_policy.pixel_gcbc.config import (
    PixelGcbcConfig,
    PixelGcbcSection,
    ShiftConfig,
)
from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy
from elast_cli.models.goal_policy.pixel_gcbc.shift import random_offsets, shifted
from elast_cli.models.goal_policy.pixel_gcbc.training import train
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import FitConfig
from tests.toys.goals import moving_square, setting

NET = PixelGcbcConfig(width=32, depth=1, pool=4, channels=8)


def test_a_shift_moves_pixels_and_repeats_the_edge() -> None:
    image = torch.arange(9.0).reshape(1, 1, 3, 3).expand(3, 2, 3, 3)
    offsets = np.array([[0, 0], [1, 0], [0, -1]])
    still, down, left = shifted(image, offsets)[:, 1]
    assert still.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert down.tolist() == [[0, 1, 2], [0, 1, 2], [3, 4, 5]]
    assert left.tolist() == [[1, 2, 2], [4, 5, 5], [7, 8, 8]]


def test_offsets_are_uniform_for_their_share_of_a_batch() -> None:
    config = ShiftConfig(pixels=1, share=0.6)
    offsets = random_offsets(np.random.default_rng(0), 30_000, config)
    pairs, counts = np.unique(offsets, axis=0, return_counts=True)
    assert len(pairs) == 9
    shares = np.full((3, 3), 0.6 / 9)
    shares[1, 1] += 0.4
    np.testing.assert_allclose(counts / 30_000, shares.ravel(), atol=0.01)
    none = ShiftConfig(pixels=0, share=1)
    assert not random_offsets(np.random.default_rng(0), 50, none).any()


@pytest.mark.parametrize("frames", [1, 3])
def test_the_policy_sees_its_frames_the_goal_and_the_context(frames: int) -> None:
    torch.manual_seed(0)
    config = NET.model_copy(update={"frames": frames})
    policy = PixelGoalPolicy(config, 2, 3)
    state, goal, context = torch.rand(1, 3, 3, 16, 16), torch.rand(1, 3, 16, 16), torch.rand(1, 3)
    action = policy(state, goal, context)
    assert action.shape == (1, 2)
    assert not torch.equal(policy(state, goal + 1, context), action)
    assert not torch.equal(policy(state, goal, context + 1), action)
    for frame in range(3):
        changed = state.clone()
        changed[:, frame] += 1
        seen = frame >= 3 - frames
        assert torch.equal(policy(changed, goal, context), action) != seen


def test_it_learns_which_action_moves_the_square_to_the_goal(tmp_path: Path) -> None:
    dataset = moving_square(episodes=300, rows=2)  # so that the goal is one step ahead
    section = PixelGcbcSection(
        net=NET.model_copy(update={"frames": 1}),
        fit=FitConfig(steps=150, batch_size=64, learning_rate=3e-3, log_every=150),
    )
    place = setting(tmp_path)
    trained = train(Inputs(dataset, {}, place), section, place)
    assert trained.metrics["val_action_r2"] > 0.6
