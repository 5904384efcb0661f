"""The conditional autoencoder: its divergence, its prior, its shapes and its objective."""

from __future__ import annotations

import math

import pytest
import torch

from elast_cli.models.cvae.config import CvaeConfig, ElboConfig
from elast_cli.models.cvae.net import Cvae, Gaussian, divergence, negative_elbo

SMALL = CvaeConfig(latent_size=3, channels=2, pool=4)


def gaussian(means: list[float], variances: list[float]) -> Gaussian:
    """One distribution of independent normals."""
    return Gaussian(torch.tensor([means]), torch.tensor([variances]).log())


def test_the_divergence_of_two_gaussians_is_the_textbooks() -> None:
    q, p = gaussian([1.0, 0.0], [4.0, 1.0]), gaussian([0.0, 0.0], [1.0, 2.0])
    first = 0.5 * (4 + 1 - 1 - math.log(4))  # 2 - ln 2
    second = 0.5 * (1 / 2 - 1 + math.log(2))
    assert divergence(q, p).tolist() == pytest.approx([first + second])
    shifted = gaussian([3.0, 0.0], [1.0, 2.0])
    assert divergence(p, shifted).tolist() == pytest.approx([9 / 2])
    assert divergence(q, q).tolist() == pytest.approx([0.0], abs=1e-7)


def test_the_divergence_is_what_torch_computes() -> None:
    torch.manual_seed(0)
    q, p = (Gaussian(torch.randn(5, 4), torch.randn(5, 4)) for _ in range(2))
    normals = [torch.distributions.Normal(x.mean, (0.5 * x.log_variance).exp()) for x in (q, p)]
    expected = torch.distributions.kl_divergence(*normals).sum(1)
    torch.testing.assert_close(divergence(q, p), expected)


def test_samples_have_the_mean_and_the_deviation() -> None:
    torch.manual_seed(0)
    found = gaussian([2.0], [9.0]).at(torch.randn(40_000, 1))
    assert float(found.mean()) == pytest.approx(2, abs=0.05)
    assert float(found.std()) == pytest.approx(3, rel=0.02)


@pytest.mark.parametrize(("pool", "channels"), [(1, [2, 4, 8, 16, 32]), (4, [2, 4, 8])])
@pytest.mark.parametrize("has_context", [False, True])
def test_images_become_latents_and_images_again(
    pool: int, channels: list[int], has_context: bool
) -> None:
    config = CvaeConfig.model_validate({"latent_size": 3, "channels": 2, "pool": pool})
    assert config.conv_channels == channels
    side = 64 // pool
    model = Cvae(config, has_context=has_context).eval()
    images = torch.rand(4, 3, side, side)
    context = torch.rand(4, 3 if has_context else 0, side, side)
    posterior, prior = model.posterior(images, context), model.prior_of(context)
    assert posterior.mean.shape == prior.log_variance.shape == (4, 3)
    made = model.images(posterior.mean)
    assert made.shape == images.shape
    assert 0 < float(made.min().detach()) < float(made.max().detach()) < 1
    torch.testing.assert_close(model.reconstructed(images, context), made)


def test_without_contexts_the_prior_is_standard_normal() -> None:
    prior = Cvae(SMALL, has_context=False).prior_of(torch.zeros(2, 0, 16, 16))
    assert prior.mean.tolist() == prior.log_variance.tolist() == [[0, 0, 0]] * 2


def test_the_prior_and_the_posterior_depend_on_the_context() -> None:
    torch.manual_seed(0)
    model = Cvae(SMALL, has_context=True).eval()
    images, one, other = torch.rand(3, 1, 3, 16, 16)
    for one_is, other_is in (
        (model.prior_of(one), model.prior_of(other)),
        (model.posterior(images, one), model.posterior(images, other)),
    ):
        assert not torch.equal(one_is.mean, other_is.mean)
        assert not torch.equal(one_is.log_variance, other_is.log_variance)


@torch.no_grad()
def test_the_objective_of_a_grey_decoder_is_ln_2_a_pixel_and_the_divergence() -> None:
    model = Cvae(SMALL, has_context=False).eval()
    for parameter in model.parameters():
        torch.nn.init.zeros_(parameter)
    torch.nn.init.constant_(model.encoder.mean.bias, 2.0)
    images, noise = torch.rand(5, 3, 16, 16), torch.zeros(5, 3)
    total, parts = negative_elbo(model, images, images[:, :0], noise, kl_weight=10.0)
    assert float(parts["bce"]) == pytest.approx(3 * 16 * 16 * math.log(2), rel=1e-5)
    assert float(parts["kl"]) == pytest.approx(3 * 2.0**2 / 2)
    assert float(total) == pytest.approx(float(parts["bce"]) + 10 * 6, rel=1e-6)


def test_the_weight_of_the_divergence_is_nothing_then_rises_and_stays() -> None:
    config = ElboConfig(kl_weight=8, free=0.25, warmup=0.75)
    assert [config.weight_at(step, 8) for step in range(8)] == [0, 0, 0, 2, 4, 6, 8, 8]
    assert ElboConfig(kl_weight=8, free=0, warmup=0).weight_at(0, 8) == 8
    sudden = ElboConfig(kl_weight=8, free=0.5, warmup=0.5)
    assert [sudden.weight_at(step, 4) for step in range(4)] == [0, 0, 8, 8]
    with pytest.raises(ValueError, match=r"warmup must be at least free, 0\.5"):
        ElboConfig(free=0.5, warmup=0.4)
