"""Training the context autoencoder on a toy: one dark square whose place is all that differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.models.context import training as context_training
from elast_cli.models.context.config import ContextConfig, ContextSection
from elast_cli.models.context.net import ContextAutoencoder, context_vectors, reconstruction_error
from elast_cli.models.context.training import train_context
from elast_cli.models.part import FitConfig, Setting, Trained
from elast_cli.progress import Silent
from elast_cli.shapes import Uint8

EPISODES = 300
SPLIT = (np.arange(270), np.arange(270, 300))
STAGE = ContextSection(
    net=ContextConfig(latent_size=4, channels=8, pool=4),
    fit=FitConfig(steps=300, batch_size=64, learning_rate=3e-3, save_every=100),
)


def places() -> Uint8:
    return np.random.default_rng(0).integers(44, size=(EPISODES, 2)).astype(np.uint8)


def squares() -> Uint8:
    images = np.full((EPISODES, 64, 64, 3), 240, np.uint8)
    for image, (x, y) in zip(images, places(), strict=True):
        image[y : y + 20, x : x + 20] = (50, 60, 70)
    return images


def trained_in(work: Path, seed: int = 0) -> Trained:
    work.mkdir(exist_ok=True)
    return train_context(
        squares(), SPLIT, STAGE, Setting(seed, work, torch.device("cpu"), Silent())
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    return trained_in(tmp_path_factory.mktemp("context"))


def test_unseen_images_are_reconstructed_and_their_vectors_say_what_differs(
    trained: Trained,
) -> None:
    assert trained.metrics["val_reconstruction_r2"] > 0.7
    assert trained.metrics["probe_knn_r2"] > 0.5
    assert trained.curve[-1]["val_mse"] < 0.8 * trained.curve[0]["val_mse"]


def test_vectors_of_training_images_are_standardised(trained: Trained) -> None:
    model = trained.module
    assert isinstance(model, ContextAutoencoder)
    found = context_vectors(model, squares()[SPLIT[0]])
    np.testing.assert_allclose(found.mean(0), 0, atol=1e-3)
    np.testing.assert_allclose(found.std(0), 1, atol=1e-3)


def test_images_held_out_change_no_weight(trained: Trained, tmp_path: Path) -> None:
    images = squares()
    images[SPLIT[1]] = 255 - images[SPLIT[1]]
    setting = Setting(0, tmp_path, torch.device("cpu"), Silent())
    other = train_context(images, SPLIT, STAGE, setting).module.state_dict()
    for name, tensor in trained.module.state_dict().items():
        assert torch.equal(tensor, other[name]), name


def test_a_killed_training_ends_with_the_same_weights(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class KilledError(Exception):
        pass

    steps = 0

    def killed(model: ContextAutoencoder, features: torch.Tensor) -> torch.Tensor:
        nonlocal steps
        steps += 1
        if steps > 150:
            raise KilledError
        return reconstruction_error(model, features)

    with monkeypatch.context() as patch:
        patch.setattr(context_training, "reconstruction_error", killed)
        with pytest.raises(KilledError):
            trained_in(tmp_path / "work")
    assert (tmp_path / "work/checkpoint.pt").exists()
    again = trained_in(tmp_path / "work")
    for name, tensor in trained.module.state_dict().items():
        assert torch.equal(tensor, again.module.state_dict()[name]), name
    assert [row["step"] for row in again.curve] == [row["step"] for row in trained.curve]
