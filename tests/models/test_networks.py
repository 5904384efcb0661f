"""Encoder, dynamics, density, policy and support, each against its definition."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from torch.nn import functional

from elast_cli.inference.dense import DenseNetwork
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.encoder.config import EncoderConfig
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.ensemble.config import EnsembleConfig
from elast_cli.models.ensemble.net import DynamicsEnsemble
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.files import arrays_of
from elast_cli.models.nets import ForwardModel, LatentScale
from elast_cli.models.policy.net import LocalPolicy
from tests.toys.models import ACTION, CONTEXT, LATENT, models


def items(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Latents, next latents, actions and contexts."""
    torch.manual_seed(1)
    return (
        torch.randn(count, LATENT),
        torch.randn(count, LATENT),
        torch.rand(count, ACTION) * 2 - 1,
        torch.randn(count, CONTEXT),
    )


def ensemble() -> DynamicsEnsemble:
    model = models()["ensemble"]
    assert isinstance(model, SupportedDynamics)
    return model.ensemble


def density() -> TransitionDensity:
    model = models()["density"]
    assert isinstance(model, TransitionDensity)
    return model


@pytest.mark.parametrize("pool", [1, 2, 4, 8])
def test_preprocessing_is_average_pooling(pool: int) -> None:
    pixels = torch.randint(256, (300, 64, 64, 3), dtype=torch.uint8)
    encoder = Encoder(EncoderConfig.model_validate({"pool": pool}))
    features = encoder.preprocess(pixels)
    channels = pixels.permute(0, 3, 1, 2).float()
    expected = functional.avg_pool2d(channels, pool) if pool > 1 else channels
    assert features.dtype == torch.float16
    torch.testing.assert_close(features.float(), expected, rtol=2**-10, atol=2**-10)


def test_normalization_leaves_no_mean_image_and_one_global_scale() -> None:
    encoder = Encoder(EncoderConfig())
    features = (torch.rand(500, 3, 16, 16) * torch.linspace(1, 200, 16)).half()
    encoder.fit_normalization(features)
    x = (features.float() - encoder.mean) / encoder.scale
    assert x.mean(0).abs().max().item() < 1e-2
    assert x.square().mean().item() == pytest.approx(1, rel=1e-3)


def test_whitened_colours_are_uncorrelated_and_vary_alike() -> None:
    mix = torch.tensor([[5.0, 3.0, 2.0], [3.0, 5.0, 2.5], [2.0, 2.5, 5.0]])
    features = torch.einsum("cd,mdhw->mchw", mix, torch.randn(500, 3, 16, 16)) + 100
    encoder = Encoder(EncoderConfig(whiten=True))
    encoder.fit_normalization(features)
    colours = encoder.normalized(features).transpose(0, 1).flatten(1)
    assert colours.mean(1).abs().max() < 1e-3
    covariance = colours @ colours.T / colours.shape[1]
    torch.testing.assert_close(covariance, torch.eye(3), atol=1e-3, rtol=0)


def test_whitening_leaves_what_is_noise_faint() -> None:
    grey = 50 * torch.randn(500, 1, 16, 16).expand(-1, 3, -1, -1)
    encoder = Encoder(EncoderConfig(whiten=True))
    encoder.fit_normalization(grey + 0.05 * torch.randn(500, 3, 16, 16))
    noise = encoder.normalized(grey + 0.05 * torch.randn(500, 3, 16, 16)) - encoder.normalized(grey)
    assert noise.square().mean() < 1e-3
    encoder.fit_normalization(torch.ones(4, 3, 16, 16))
    assert encoder.normalized(torch.ones(4, 3, 16, 16)).abs().max() == 0


@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
@pytest.mark.parametrize("pool", [1, 4, 8])
def test_every_encoder_sees_all_frames(architecture: str, pool: int) -> None:
    torch.manual_seed(0)
    config = EncoderConfig.model_validate(
        {"architecture": architecture, "pool": pool, "latent_size": 5, "width": 16}
    )
    encoder = Encoder(config)
    side = 64 // pool
    base = torch.rand(1, 3, 3, side, side)
    z = encoder(base)
    assert z.shape == (1, 5)
    for frame in range(3):
        changed = base.clone()
        changed[:, frame] += 1
        assert not torch.equal(z, encoder(changed))


@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
def test_an_encoder_of_one_frame_sees_the_last(architecture: str) -> None:
    torch.manual_seed(0)
    keys = {"architecture": architecture, "pool": 8, "frames": 1, "width": 16, "channels": 4}
    encoder = Encoder(EncoderConfig.model_validate(keys))
    base = torch.rand(1, 3, 3, 8, 8)
    earlier, last = base.clone(), base.clone()
    earlier[:, :2] += 1
    last[:, 2] += 1
    torch.testing.assert_close(encoder(earlier), encoder(base))
    assert not torch.equal(encoder(last), encoder(base))


def test_the_scale_is_the_mean_the_deviation_and_the_root_mean_square_step() -> None:
    scale = LatentScale(2)
    z = torch.tensor([[0.0, 0.0], [2.0, 4.0]])
    scale.fit(z, z + torch.tensor([[3.0, 0.0], [4.0, 0.0]]))
    assert scale.mean.tolist() == [1, 2]
    assert scale.std.tolist() == pytest.approx([2**0.5, 8**0.5])
    assert scale.step.tolist() == pytest.approx([12.5**0.5, 1e-6])


def test_the_forward_model_is_a_residual() -> None:
    model = ForwardModel(LATENT, ACTION, CONTEXT, 8)
    for parameter in model.parameters():
        parameter.data.zero_()
    z, _, action, context = items(5)
    torch.testing.assert_close(model(z, action, context), z)


def test_the_ensemble_predicts_the_mean_and_the_spread_of_its_members() -> None:
    model = ensemble()
    z, _, action, context = items(6)
    steps = model.members(z, action, context) * model.scale.step
    mean, variance = model(z, action, context)
    torch.testing.assert_close(mean, z + steps.mean(0))
    torch.testing.assert_close(variance, steps.var(0, correction=0).sum(1))


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_members_of_every_depth_are_what_the_search_calls(depth: int) -> None:
    config = EnsembleConfig(members=2, width=16, depth=depth)
    model = DynamicsEnsemble(config, LATENT, ACTION, CONTEXT)
    assert len(model.layers) == depth + 1
    z, _, action, context = items(5)
    inputs = torch.cat([model.scale(z), action, context], dim=1).numpy()
    expected = model.members(z, action, context).detach()
    found = DenseNetwork.of(arrays_of(model.layers))(inputs)
    np.testing.assert_allclose(found, expected, 1e-4, 1e-5)


def test_members_may_each_have_their_own_inputs() -> None:
    model = ensemble()
    z, _, action, context = (x.unflatten(0, (3, 2)) for x in items(6))
    together = model.members(z, action, context)
    for e in range(3):
        alone = model.members(z[e], action[e], context[e])[e]
        torch.testing.assert_close(together[e], alone)


def test_the_noise_is_a_gaussian_about_the_source() -> None:
    psi = density()
    z, z_next, _, _ = items(3)
    for i in range(3):
        covariance = np.diag(psi.noise_std().square().numpy())
        expected = multivariate_normal(z[i].numpy(), covariance).logpdf(z_next[i].numpy())
        assert psi.log_noise(z, z_next)[i].item() == pytest.approx(expected, rel=1e-4)


def test_the_density_is_relative_to_noise_from_data_and_absolute_otherwise() -> None:
    psi = density()
    z, z_next, _, context = items(5)
    ratio = psi.log_ratio(z, z_next, context)
    torch.testing.assert_close(psi(z, z_next, context), ratio)
    psi.config = psi.config.model_copy(update={"near_share": 0.0, "context_share": 0.5})
    torch.testing.assert_close(psi(z, z_next, context), ratio)
    psi.config = psi.config.model_copy(update={"near_share": 0.0, "context_share": 0.0})
    torch.testing.assert_close(psi(z, z_next, context), ratio + psi.log_noise(z, z_next))


def test_features_of_two_nodes_add_up_to_the_first_layer() -> None:
    psi = density()
    z, z_next, _, context = items(5)
    width = psi.config.width
    away, ahead = psi.features(z, context), psi.features(z_next, context)
    hidden = away[:, :width] + ahead[:, width : 2 * width]
    ratio = psi.log_ratio_from_hidden(hidden)
    torch.testing.assert_close(ratio, psi.log_ratio(z, z_next, context), rtol=1e-4, atol=1e-5)


def test_the_policys_actions_lie_in_the_box() -> None:
    model = models()["policy"]
    assert isinstance(model, LocalPolicy)
    z, z_next, _, context = items(50)
    action = model(z, 1000 * z_next, context)
    assert action.shape == (50, ACTION)
    assert action.abs().max().item() <= 1


def test_the_support_finds_the_nearest_state() -> None:
    model = models()["ensemble"]
    assert isinstance(model, SupportedDynamics)
    support, z = model.support, torch.randn(3000, LATENT)
    gap = (z[:, None] - support.latents).norm(dim=2)
    torch.testing.assert_close(support.distance(z), gap.amin(1), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(gap.gather(1, support.nearest(z)[:, None])[:, 0], gap.amin(1))


def test_a_step_length_is_a_quantile_of_the_steps() -> None:
    model = models()["encoder"]
    assert isinstance(model, Representation)
    model.step_length_quantiles.fit(torch.linspace(0, 2, 101))
    assert model.step_length(0.75) == pytest.approx(1.5)
