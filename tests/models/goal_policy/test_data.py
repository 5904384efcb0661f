"""States and goals in latent space: goals are encoded as tasks show them, at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.models.encoder.config import EncoderConfig
from elast_cli.models.encoder.encode import encode, encode_goals
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.outputs import Outputs
from elast_cli.shapes import FRAMES
from tests.toys.goals import goal_data, moving_square, setting


@pytest.mark.parametrize("frames", [1, 3])
def test_goals_are_the_latents_of_states_at_rest(frames: int, tmp_path: Path) -> None:
    torch.manual_seed(0)
    keys = {"latent_size": 3, "width": 8, "pool": 8, "frames": frames}
    encoder = Encoder(EncoderConfig.model_validate(keys))
    dataset, place = moving_square(episodes=3, rows=4), setting(tmp_path)
    outputs = Outputs(tmp_path / "cache", "digest")
    words = dataset, torch.zeros(3, 0), encoder, place
    states = encode(*words, outputs=outputs).z
    goals = encode_goals(*words, outputs=outputs)
    features = encoder.preprocess(torch.from_numpy(dataset.pixels[:]))
    with torch.no_grad():
        resting = encoder(features[:, None].expand(-1, FRAMES, -1, -1, -1))
    torch.testing.assert_close(goals, resting)
    assert torch.equal(states, goals) == (frames == 1)
    assert torch.equal(states[::4], goals[::4])  # an episode begins at rest
    assert torch.equal(encode_goals(*words, outputs=outputs), goals)
    torch.testing.assert_close(encode_goals(*words), goals)


def test_a_state_has_arrived_where_it_looks_like_its_goal() -> None:
    z = np.zeros((12, 3, 2))
    z[:, 1, 1] = z[:, 2, 0] = 1
    data = goal_data(z, np.zeros((12, 3, 1)))
    rows, goals = np.array([0, 0, 1, 3, 2]), np.array([0, 1, 4, 5, 11])
    assert data.arrived(rows, goals).tolist() == [True, False, True, False, True]
    here, there, context = data.towards(rows, goals)
    assert there[1].tolist() == [0, 1]
    assert here[4].tolist() == [1, 0]
    assert context.shape == (5, 0)
