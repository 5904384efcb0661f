"""Training the recurrent state-space model on lamps that actions dim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.models.inputs import Inputs
from elast_cli.models.part import FitConfig, Trained
from elast_cli.models.rssm import training
from elast_cli.models.rssm.config import ElboConfig, RssmConfig, RssmSection
from elast_cli.models.rssm.elbo import elbo_loss
from elast_cli.models.rssm.net import Rssm
from elast_cli.models.rssm.training import train
from tests.toys.goals import moving_square, setting, two_lamps
from tests.toys.models import SMALL_RSSM

TINY = RssmSection(
    net=SMALL_RSSM,
    elbo=ElboConfig(length=4),
    fit=FitConfig(steps=7, batch_size=3, log_every=3, save_every=2),
)
LEARNS = RssmSection(
    net=RssmConfig(stochastic=8, belief=32, hidden=32, channels=2),
    elbo=ElboConfig(length=8),
    fit=FitConfig(steps=300, batch_size=8, learning_rate=1e-2, log_every=50),
)


class Killed(BaseException):
    """Stands for a process that ends here."""


def trained_in(work: Path, section: RssmSection = TINY, rows: int = 6, seed: int = 0) -> Trained:
    place = setting(work, seed)
    return train(Inputs(moving_square(12, rows), {}, place), section, place)


def assert_same(one: Trained, other: Trained) -> None:
    """Equal to the bit."""
    assert one.curve == other.curve
    assert one.metrics == other.metrics
    theirs = other.module.state_dict()
    for name, tensor in one.module.state_dict().items():
        assert torch.equal(tensor, theirs[name]), name


def test_a_killed_training_ends_as_one_that_was_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, batches = trained_in(tmp_path / "whole"), 0

    def until_killed(*words: Any) -> Any:
        nonlocal batches
        batches += 1
        if batches == 7:  # six of training and validation: the last checkpoint is of step 4
            raise Killed
        return elbo_loss(*words)

    with monkeypatch.context() as patch:
        patch.setattr(training, "elbo_loss", until_killed)
        with pytest.raises(Killed):
            trained_in(tmp_path / "broken")
    assert (tmp_path / "broken/checkpoint.pt").exists()
    assert_same(trained_in(tmp_path / "broken"), whole)


def test_another_seed_gives_another_model(tmp_path: Path) -> None:
    one, other = (trained_in(tmp_path / str(seed), seed=seed) for seed in (0, 1))
    last = one.module.state_dict()["to_prior.2.bias"]
    assert not torch.equal(last, other.module.state_dict()["to_prior.2.bias"])


@pytest.mark.parametrize("rows", [2, 3, 30])
def test_episodes_of_any_length_are_trained_on(rows: int, tmp_path: Path) -> None:
    trained = trained_in(tmp_path, rows=rows)
    assert all(np.isfinite(value) for value in trained.metrics.values())
    shown = trained.reconstructions
    assert shown is not None
    assert len(shown.images) == min(rows, 4) == len(shown.labels)
    assert [len(images) for images in shown.decoded.values()] == [len(shown.images)] * 2


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A model of lamps, each as bright as the sum of its actions."""
    place = setting(tmp_path_factory.mktemp("rssm"))
    return train(Inputs(two_lamps(episodes=60, rows=10), {}, place), LEARNS, place)


def test_it_learns_to_see_and_to_predict(learned: Trained) -> None:
    """Predictions without images beat the last image that was seen."""
    first, last, found = learned.curve[0], learned.curve[-1], learned.metrics
    assert last["val_loss"] < 0.5 * first["val_loss"]
    assert found["val_open_loop_rmse"] < 0.7 * found["val_no_change_rmse"]
    assert found["val_reconstruction_rmse"] < found["val_open_loop_rmse"] * 1.05


def test_its_state_says_how_bright_the_lamps_are(learned: Trained) -> None:
    assert learned.metrics["probe_knn_r2"] > 0.8
    model = learned.module
    assert isinstance(model, Rssm)
    assert 0 < model.step_length_quantiles.at(0.1) < model.step_length_quantiles.at(0.9)
