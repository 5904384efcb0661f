"""Batches of lookalikes: windows that end close together in latent space."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.config import validate
from elast_cli.errors import ConfigError
from elast_cli.models.encoder.config import EncoderSection
from elast_cli.models.encoder.hard_negatives import HardNegatives
from elast_cli.shapes import Float32, Int64

STARTS = np.arange(0, 4000, 2)


def on_a_line(rows: Int64) -> Float32:
    """Latents [P,1] in another order than the rows."""
    return (rows * 7 % 4001).astype(np.float32)[:, None]


def lookalikes(refresh: int = 10) -> HardNegatives:
    return HardNegatives(STARTS, on_a_line, group=4, refresh=refresh)


def test_a_batch_is_groups_of_windows_that_end_alike_and_the_rest_at_random() -> None:
    rows = lookalikes().batch(np.random.default_rng(0), 30)
    assert rows.shape == (30,)
    assert np.isin(rows, STARTS).all()
    groups = on_a_line(rows[:28]).reshape(7, 4)
    assert np.ptp(groups, axis=1).max() < 20  # of 4001
    assert np.ptp(on_a_line(rows[28:])) > 20


def test_the_search_follows_the_encoder() -> None:
    searched = []

    def encode(rows: Int64) -> Float32:
        searched.append(len(rows))
        return on_a_line(rows)

    batches = HardNegatives(STARTS, encode, group=4, refresh=3)
    for step in range(7):
        batches.batch(np.random.default_rng(step), 8)
    assert len(searched) == 3


def test_an_interruption_at_a_refresh_changes_nothing() -> None:
    whole = lookalikes(refresh=5)
    batches = [whole.batch(np.random.default_rng(step), 16) for step in range(15)]
    resumed = lookalikes(refresh=5)
    for step in range(10, 15):
        np.testing.assert_array_equal(resumed.batch(np.random.default_rng(step), 16), batches[step])


def test_checkpoints_lie_where_the_search_is_renewed() -> None:
    config = {"cpc": {"lookalikes": 8, "refresh": 300}, "fit": {"steps": 9, "batch_size": 16}}
    with pytest.raises(ConfigError, match=r"save_every"):
        validate(EncoderSection, config, where="test")
    config["cpc"]["refresh"] = 250
    validate(EncoderSection, config, where="test")
