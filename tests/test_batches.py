"""Batches of lookalikes: windows that end close together in latent space."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.batches import Lookalikes
from elast_cli.config import validate
from elast_cli.errors import ConfigError
from elast_cli.shapes import Float32, Int64
from elast_cli.training import EncoderStage

STARTS = np.arange(0, 4000, 2)


def on_a_line(rows: Int64) -> Float32:
    """Latents [P,1] in another order than the rows."""
    return (rows * 7 % 4001).astype(np.float32)[:, None]


def lookalikes(refresh: int = 10) -> Lookalikes:
    return Lookalikes(STARTS, on_a_line, group=4, refresh=refresh)


def test_a_batch_is_groups_of_windows_that_end_alike_and_the_rest_at_random() -> None:
    rows = lookalikes().batch(np.random.default_rng(0), 30)
    assert rows.shape == (30,)
    assert np.isin(rows, STARTS).all()
    groups = on_a_line(rows[:28]).reshape(7, 4)
    assert np.ptp(groups, axis=1).max() < 20  # of 4001
    assert np.ptp(on_a_line(rows[28:])) > 20


def test_what_lies_beyond_a_fold_of_the_latent_space_comes_into_a_group() -> None:
    def folded(rows: Int64) -> Float32:
        return np.minimum(rows, 4000 - rows).astype(np.float32)[:, None]

    def picture(rows: Int64) -> Float32:
        return rows.astype(np.float32)[:, None]

    def across(batches: Lookalikes) -> Float32:
        """Share of each group on the other side of the fold than its first window."""
        groups = batches.batch(np.random.default_rng(0), 400).reshape(-1, 4)
        side = groups < 2000
        assert np.ptp(folded(groups), axis=1).max() <= 200
        share: Float32 = (side != side[:, :1]).mean(1)
        return share[np.abs(groups[:, 0] - 2000) > 200]

    seeing = Lookalikes(STARTS, folded, group=4, refresh=10, picture=picture)
    assert (across(seeing)[:, None] >= 0.5).all()
    blind = across(Lookalikes(STARTS, folded, group=4, refresh=10))
    assert blind.max() < 1


def test_the_search_follows_the_encoder() -> None:
    searched = []

    def encode(rows: Int64) -> Float32:
        searched.append(len(rows))
        return on_a_line(rows)

    batches = Lookalikes(STARTS, encode, group=4, refresh=3)
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
        validate(EncoderStage, config, where="test")
    config["cpc"]["refresh"] = 250
    validate(EncoderStage, config, where="test")
