from __future__ import annotations

import numpy as np
import pytest

from elast_cli.models.probe import probe_state

ROWS = np.arange(2000)
TRAIN, VAL = ROWS[:1600], ROWS[1600:]


def test_a_linear_latent_is_read_by_the_linear_probe() -> None:
    z = np.random.default_rng(0).standard_normal((2000, 3)).astype(np.float32)
    state = z @ np.array([[1, 0], [2, 1], [0, -1]], np.float32) + 5
    found = probe_state(z, state, TRAIN, VAL)
    assert found["probe_linear_rmse"] < 1e-3
    assert found["probe_linear_r2"] == pytest.approx(1, abs=1e-5)


def test_a_curved_latent_is_read_by_its_neighbors_alone() -> None:
    angle = np.random.default_rng(0).uniform(0, 6, 2000)
    z = np.c_[np.cos(angle), np.sin(angle)].astype(np.float32)
    found = probe_state(z, angle[:, None].astype(np.float32), TRAIN, VAL)
    assert found["probe_knn_rmse"] < 0.1
    assert found["probe_knn_r2"] > 0.99
    assert found["probe_linear_r2"] < 0.9


def test_noise_holds_nothing_of_the_state() -> None:
    rng = np.random.default_rng(0)
    z, state = (rng.standard_normal((2000, 2)).astype(np.float32) for _ in range(2))
    found = probe_state(z, state, TRAIN, VAL)
    assert abs(found["probe_linear_r2"]) < 0.1
    assert found["probe_linear_rmse"] == pytest.approx(1, abs=0.1)
