"""Training the conditional autoencoder on a square that moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.data.dataset import Dataset
from elast_cli.models.cvae.config import CvaeConfig, CvaeSection, ElboConfig
from elast_cli.models.cvae.images import ImagePairs, as_bytes
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.cvae.training import held_out_loss, train
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import FitConfig, Setting, Trained
from tests.toys.goals import moving_square, setting
from tests.toys.killed import assert_killed_ends_as_whole

NET = CvaeConfig(latent_size=4, channels=4, pool=4)


def with_contexts(dataset: Dataset) -> Dataset:
    """The same with a context image an episode, whose brightness is the episode's number."""
    grey = np.arange(dataset.episodes, dtype=np.uint8)[:, None, None, None]
    return replace(dataset, context=np.broadcast_to(grey, (dataset.episodes, 64, 64, 3)).copy())


def trained(
    place: Setting, dataset: Dataset, steps: int = 7, *, kl_weight: float = 10.0
) -> Trained:
    fit = FitConfig(steps=steps, batch_size=16, learning_rate=3e-3, log_every=100, save_every=2)
    section = CvaeSection(net=NET, elbo=ElboConfig(kl_weight=kl_weight), fit=fit)
    return train(Inputs(dataset, {}, place), section, place)


@pytest.mark.parametrize("contexts", [False, True])
def test_a_killed_training_ends_as_one_that_was_not(
    contexts: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = moving_square(12, 4)
    dataset = with_contexts(dataset) if contexts else dataset
    # the last checkpoint is of step 4
    assert_killed_ends_as_whole(
        lambda place: trained(place, dataset), (ImagePairs, "take"), 6, tmp_path, monkeypatch
    )


def test_it_learns_where_the_square_is_and_draws_it_anywhere(tmp_path: Path) -> None:
    dataset = moving_square(150, 4)
    before, after = (
        trained(setting(tmp_path / str(steps)), dataset, steps, kl_weight=0.5) for steps in (1, 250)
    )
    assert after.metrics["val_bce_excess"] < 0.4 * before.metrics["val_bce_excess"]
    assert after.metrics["val_rmse"] < 0.6 * before.metrics["val_rmse"]
    assert after.metrics["val_kl"] > 0.5
    assert after.module.steps == 250
    assert not after.module.training
    shown = after.reconstructions
    assert shown is not None
    assert [*shown.decoded] == ["reconstructed", "sample 1", "sample 2", "sample 3", "sample 4"]
    assert len(shown.labels) == len(shown.images)
    for images in (shown.images, *shown.decoded.values()):
        assert images.shape[1:] == (16, 16, 3)
        assert images.dtype == np.uint8


def test_frames_come_with_the_context_image_of_their_episode(tmp_path: Path) -> None:
    dataset = with_contexts(moving_square(5, 3))
    pairs = ImagePairs.of(dataset, Cvae(NET, has_context=True), setting(tmp_path))
    images, context = pairs.take(np.array([0, 2, 3, 14]))
    assert images.shape == context.shape == (4, 3, 16, 16)
    assert (255 * context[:, 0, 0, 0]).round().tolist() == [0, 0, 1, 4]
    blocks = dataset.pixels[:1].reshape(1, 16, 4, 16, 4, 3).mean((2, 4))  # averaged by hand
    np.testing.assert_allclose(as_bytes(images[:1]), blocks, atol=1)


def test_validation_changes_no_statistics_and_is_of_the_running_ones(tmp_path: Path) -> None:
    dataset = moving_square(6, 3)
    model = Cvae(NET, has_context=False).train()
    pairs = ImagePairs.of(dataset, model, setting(tmp_path))
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    rows = np.arange(18)
    whole, parts = held_out_loss(model, pairs, rows), held_out_loss(model, pairs, rows[:9])
    more = held_out_loss(model, pairs, rows[9:])
    assert whole["bce"] == pytest.approx((parts["bce"] + more["bce"]) / 2, rel=1e-5)
    assert model.training
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, before[name]), name


def test_the_excess_of_a_perfect_reconstruction_is_nothing(tmp_path: Path) -> None:
    dataset = moving_square(3, 2)
    dataset = replace(dataset, pixels=np.full_like(dataset.pixels, 51))  # brightness 1/5
    model = Cvae(NET, has_context=False)
    for parameter in model.parameters():
        torch.nn.init.zeros_(parameter)
    last = model.decoder[-1]
    assert isinstance(last, torch.nn.ConvTranspose2d)
    assert last.bias is not None
    torch.nn.init.constant_(last.bias, float(np.log(0.2 / 0.8)))
    pairs = ImagePairs.of(dataset, model, setting(tmp_path))
    found = held_out_loss(model, pairs, np.arange(6))
    assert found["bce_excess"] == pytest.approx(0, abs=1e-3)
    assert found["rmse"] == pytest.approx(0, abs=1e-3)
    assert found["bce"] == pytest.approx(768 * -(0.2 * np.log(0.2) + 0.8 * np.log(0.8)), rel=1e-5)
