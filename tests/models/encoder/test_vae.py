"""The β-VAE: its divergence, its bound, what it learns, and that h_f does not change it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.data.dataset import Dataset
from elast_cli.models.encoder.config import CpcConfig, EncoderConfig, EncoderSection, VaeConfig
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.encoder.training import train_encoder
from elast_cli.models.encoder.vae import BetaVae, divergence, vae_loss
from elast_cli.models.part import FitConfig, Trained
from tests.toys.square import EPISODES, recorded, setting

SMALL = EncoderConfig(latent_size=3, width=32, pool=4, channels=4)
CONV = SMALL.model_copy(update={"architecture": "conv", "pool": 2})


def toy_vae(net: EncoderConfig = SMALL) -> BetaVae:
    torch.manual_seed(0)
    return BetaVae(Representation(net, CpcConfig(dynamics_width=8), 2, 0))


def batch(
    net: EncoderConfig = SMALL, m: int = 4
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Windows of two steps: features, actions, no context."""
    side = net.side
    return torch.rand(m, 3, 3, 3, side, side), torch.rand(m, 2, 2), torch.zeros(m, 0)


def test_the_divergence_is_that_of_two_gaussians_by_hand() -> None:
    mean, variance = (
        torch.tensor([[1.0, -2.0], [0.0, 0.0]]),
        torch.tensor([[4.0, 0.25], [1.0, 1.0]]),
    )
    by_hand = 0.5 * (1 + 4 - 1 - math.log(4)) + 0.5 * (4 + 0.25 - 1 - math.log(0.25))
    assert divergence(mean, variance.log()).tolist() == pytest.approx([by_hand, 0.0])


def test_the_divergence_agrees_with_torchs() -> None:
    mean, log_variance = torch.randn(5, 3), torch.randn(5, 3)
    posterior = torch.distributions.Normal(mean, (0.5 * log_variance).exp())
    wanted = torch.distributions.kl_divergence(posterior, torch.distributions.Normal(0.0, 1.0))
    assert torch.allclose(divergence(mean, log_variance), wanted.sum(1), atol=1e-5)


@pytest.mark.parametrize("net", [SMALL, CONV], ids=["pooled-mlp", "conv"])
def test_the_loss_is_made_of_its_parts(net: EncoderConfig) -> None:
    vae, (features, actions, context) = toy_vae(net), batch(net)
    noise = torch.zeros(12, 3)
    loss, parts = vae_loss(vae, features, actions, context, noise, 2.5)
    wanted = parts["reconstruction"] + 2.5 * parts["kl"] + parts["consistency"]
    assert loss.item() == pytest.approx(wanted.item())
    flat = features.flatten(0, 1)
    frames = vae.model.encoder.seen(flat)
    decoded = vae.decoder(vae.model.encoder(flat))  # without noise: the mean, which is φ's latent
    error = 0.5 * (decoded - frames.flatten(1)).square().sum(1).mean()
    assert parts["reconstruction"].item() == pytest.approx(error.item(), rel=1e-5)


def test_noise_is_scaled_by_the_posteriors_deviation() -> None:
    vae, (features, actions, context) = toy_vae(), batch()
    with torch.no_grad():
        vae.log_variance.weight.zero_()
        vae.log_variance.bias.fill_(-60.0)
    losses = [
        vae_loss(vae, features, actions, context, noise, 0.0)[1]["reconstruction"].item()
        for noise in (torch.zeros(12, 3), torch.ones(12, 3))
    ]
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)
    with torch.no_grad():
        vae.log_variance.bias.zero_()
    other = vae_loss(vae, features, actions, context, torch.ones(12, 3), 0.0)[1]
    assert other["reconstruction"].item() != pytest.approx(losses[0], rel=1e-4)


def test_h_f_learns_on_the_latents_and_does_not_change_them() -> None:
    vae, (features, actions, context) = toy_vae(), batch()
    _, parts = vae_loss(vae, features, actions, context, torch.zeros(12, 3), 1.0)
    parts["consistency"].backward()
    assert all(p.grad is None for p in vae.model.encoder.parameters())
    assert all(p.grad is not None for p in vae.model.dynamics.parameters())


def test_without_the_divergence_it_reconstructs_a_dozen_states() -> None:
    vae = toy_vae(SMALL.model_copy(update={"width": 64}))
    features, actions, context = batch()
    noise = torch.zeros(12, 3)
    optimizer = torch.optim.Adam(vae.parameters(), lr=3e-3)
    for _ in range(400):
        optimizer.zero_grad()
        loss, parts = vae_loss(vae, features, actions, context, noise, 0.0)
        loss.backward()
        optimizer.step()
    pixels = features.flatten(0, 1).flatten(1)
    mean_image = 0.5 * (pixels - pixels.mean(0)).square().sum(1).mean()
    assert parts["reconstruction"] < 0.05 * mean_image


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return recorded()


def trained(dataset: Dataset, beta: float, work: Path, steps: int = 400) -> Trained:
    section = EncoderSection(
        objective="beta-vae",
        net=SMALL,
        cpc=CpcConfig(horizon=2, dynamics_width=32, lookalikes=8, refresh=5),
        vae=VaeConfig(beta=beta),
        fit=FitConfig(steps=steps, batch_size=64, learning_rate=3e-3, log_every=50, save_every=50),
    )
    return train_encoder(dataset, torch.zeros(EPISODES, 0), section, setting(work))


def test_without_the_divergence_it_is_an_autoencoder_of_the_toy(
    dataset: Dataset, tmp_path: Path
) -> None:
    found = trained(dataset, 0.0, tmp_path / "zero")
    mean_image = 0.5 * 3 * 3 * SMALL.side**2  # what it costs to decode that: a half of each pixel
    assert found.curve[-1]["val_reconstruction"] < 0.6 * mean_image
    assert isinstance(found.module, Representation)  # no decoder is stored
    names = dict(found.module.state_dict())
    assert set(names) == set(found.spec.tensors())  # type: ignore[attr-defined]  # of its spec


def test_latents_hold_the_state_unless_a_large_weight_empties_them(
    dataset: Dataset, tmp_path: Path
) -> None:
    few, much = (trained(dataset, beta, tmp_path / f"{beta}", 150) for beta in (1.0, 1e5))
    assert much.metrics["val_kl"] < 0.01 * few.metrics["val_kl"]
    assert much.metrics["val_reconstruction"] > 1.4 * few.metrics["val_reconstruction"]
    assert few.metrics["probe_knn_r2"] > 0.8 > 0.1 > much.metrics["probe_knn_r2"]
    errors = [found.metrics["val_one_step_error_in_steps"] for found in (few, much)]
    assert errors[0] < 1.5 < errors[1]


def test_a_training_repeats_to_the_bit(dataset: Dataset, tmp_path: Path) -> None:
    one, two = (trained(dataset, 4.0, tmp_path / name, 20) for name in ("one", "two"))
    for name, tensor in one.module.state_dict().items():
        assert torch.equal(tensor, two.module.state_dict()[name]), name
    assert one.curve == two.curve


def test_a_recipe_without_it_is_what_it_was_before_there_was_a_vae() -> None:
    plain = EncoderSection()
    assert set(plain.determining()) == {"net", "cpc", "fit"}
    assert EncoderSection(vae=VaeConfig(beta=9)).determining() == plain.determining()
    own = EncoderSection(objective="beta-vae").determining()
    assert (own["objective"], own["vae"]) == ("beta-vae", {"beta": 4.0})


def test_the_toys_square_moves(dataset: Dataset) -> None:
    assert np.ptp(dataset.state, axis=0).min() > 20
