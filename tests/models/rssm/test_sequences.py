"""Sequences of a dataset: what lies in them, and what happens at an episode's end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.models.rssm.images import dequantised
from elast_cli.models.rssm.sequences import SequenceData, sequence_starts
from tests.toys.goals import dataset_of, setting

EPISODES, ROWS = 3, 6


@pytest.fixture
def data(tmp_path: Path) -> SequenceData:
    """Images as bright as their row's number, in steps of 8."""
    return SequenceData(dataset, setting(tmp_path))


rng = np.random.default_rng(0)
PIXELS = np.empty((EPISODES * ROWS, 64, 64, 3), np.uint8)
PIXELS[:] = 8 * np.arange(EPISODES * ROWS)[:, None, None, None]
ACTION = rng.uniform(-1, 1, (EPISODES, ROWS, 2)).astype(np.float32)
dataset = dataset_of(ACTION, PIXELS)


def test_each_frame_stands_beside_the_action_that_led_to_it(data: SequenceData) -> None:
    found = data.take(np.array([1, 8]), 3)
    assert found.images.shape == (2, 3, 3, 64, 64)
    codes = torch.tensor([[1, 2, 3], [8, 9, 10]], dtype=torch.uint8)
    torch.testing.assert_close(found.images[:, :, 0, 0, 0], dequantised(codes))
    assert not found.action[:, 0].any()
    np.testing.assert_array_equal(found.action[0, 1:], ACTION[0, 1:3])
    np.testing.assert_array_equal(found.action[1, 1:], ACTION[1, 2:4])
    assert found.known.all()


def test_a_sequence_ends_where_its_episode_ends(data: SequenceData) -> None:
    found = data.take(np.array([3]), 5)
    assert found.known.tolist() == [[True, True, True, False, False]]
    assert torch.isfinite(found.action).all()
    codes = torch.tensor([3, 4, 5, 5, 5], dtype=torch.uint8)  # nothing of the next episode
    torch.testing.assert_close(found.images[0, :, 0, 0, 0], dequantised(codes))


@pytest.mark.parametrize(
    ("length", "starts"),
    [(6, [6, 12]), (4, [6, 7, 8, 12, 13, 14]), (9, [6, 12])],  # shorter episodes are taken whole
)
def test_sequences_start_where_they_fit(length: int, starts: list[int]) -> None:
    assert sequence_starts(dataset, np.array([1, 2]), length).tolist() == starts


def test_noise_is_that_of_the_generator(data: SequenceData) -> None:
    first = np.array([0, 6])
    one, same, other = (
        data.take(first, 2, torch.Generator().manual_seed(seed)).images for seed in (0, 0, 1)
    )
    assert torch.equal(one, same)
    assert not torch.equal(one, other)
    assert float((one - data.take(first, 2).images).abs().max()) <= 0.5 / 32 + 1e-6
