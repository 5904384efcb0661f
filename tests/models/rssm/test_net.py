"""PlaNet's model: images of five bits, divergences by hand, beliefs step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from elast_cli.models.rssm.config import ElboConfig, RssmConfig
from elast_cli.models.rssm.elbo import Sequences, elbo_loss, gaussian_kl, mean_of
from elast_cli.models.rssm.images import dequantised, grey_levels, quantised, shown
from elast_cli.models.rssm.net import Gaussian, Rssm
from tests.toys.models import SMALL_RSSM

B, L, A = 3, 4, 2
S, D = SMALL_RSSM.stochastic, SMALL_RSSM.belief


@pytest.fixture(scope="module")
def model() -> Rssm:
    torch.manual_seed(0)
    return Rssm(SMALL_RSSM, A).requires_grad_(False).eval()


def batch(length: int = L) -> Sequences:
    draws = torch.Generator().manual_seed(1)
    images = torch.rand(B, length, 3, 64, 64, generator=draws) - 0.5
    action = torch.rand(B, length, A, generator=draws) * 2 - 1
    return Sequences(images, action, torch.ones(B, length, dtype=torch.bool))


def test_a_colour_becomes_one_of_32_codes() -> None:
    pixels = torch.tensor([0, 7, 8, 131, 255], dtype=torch.uint8).reshape(5, 1, 1, 1)
    codes = quantised(pixels.expand(5, 64, 64, 3))
    assert codes.shape == (5, 3, 64, 64)
    assert codes.dtype == torch.uint8
    assert codes[:, 0, 0, 0].tolist() == [0, 0, 1, 16, 31]


def test_images_lie_in_the_middle_of_their_codes_or_anywhere_in_them() -> None:
    codes = torch.tensor([0, 16, 31], dtype=torch.uint8)
    still = dequantised(codes)
    assert still.tolist() == [0.5 / 32 - 0.5, 16.5 / 32 - 0.5, 31.5 / 32 - 0.5]
    many = dequantised(codes[:, None].expand(3, 20_000), torch.Generator().manual_seed(0))
    bins = (many + 0.5) * 32 - codes[:, None]
    assert 0 <= float(bins.min()) < 0.001
    assert 0.999 < float(bins.max()) < 1 + 1e-5
    assert bins.mean(1).tolist() == pytest.approx([0.5] * 3, abs=0.01)


def test_an_image_is_shown_with_the_grey_levels_that_it_had() -> None:
    pixels = np.arange(256, dtype=np.uint8).repeat(48).reshape(1, 64, 64, 3)
    found = shown(dequantised(quantised(torch.from_numpy(pixels))))
    assert found.shape == pixels.shape
    assert np.abs(found.astype(int) - pixels).max() <= 4
    assert grey_levels(torch.tensor([-3.0, 3.0])).tolist() == [0, 255]


@pytest.mark.parametrize(
    ("one", "other", "nats"),
    [
        ((0.0, 1.0), (0.0, 1.0), 0.0),
        ((1.5, 1.0), (0.0, 1.0), 1.5**2 / 2),
        ((0.0, 2.0), (0.0, 1.0), math.log(1 / 2) + (4 - 1) / 2),
        ((1.0, 0.5), (-1.0, 3.0), math.log(3 / 0.5) + (0.25 + 4) / 18 - 0.5),
    ],
)
def test_divergences_are_those_worked_out_by_hand(
    one: tuple[float, float], other: tuple[float, float], nats: float
) -> None:
    """KL = ln(σ'/σ) + (σ² + (μ - μ')²) / 2σ'² - 1/2, and dimensions add up."""
    p, q = (Gaussian(*(torch.tensor([x, x]) for x in pair)) for pair in (one, other))
    assert gaussian_kl(p, q).item() == pytest.approx(2 * nats, abs=1e-6)


def test_divergences_are_those_of_torch() -> None:
    p, q = (Gaussian(torch.randn(7, 5), torch.rand(7, 5) + 0.1) for _ in range(2))
    exact = torch.distributions.kl_divergence(
        torch.distributions.Normal(*p), torch.distributions.Normal(*q)
    )
    torch.testing.assert_close(gaussian_kl(p, q), exact.sum(1))


def test_shapes_of_beliefs_and_images(model: Rssm) -> None:
    images = batch()
    found = model.filtered(model.embed(images.images), images.action, torch.randn(B, L, S))
    for one in (found.prior, found.posterior):
        assert one.mean.shape == one.std.shape == (B, L, S)
        assert float(one.std.min()) >= SMALL_RSSM.min_std
    assert found.belief.shape == (B, L, D)
    assert model.decode(found.state, found.belief).shape == (B, L, 3, 64, 64)
    assert model.decode(found.state[0], found.belief[0]).shape == (L, 3, 64, 64)


def test_a_full_size_image_is_encoded_as_the_paper_does() -> None:
    """32-64-128-256 channels without padding end at 2 x 2: 1,024 numbers."""
    paper = Rssm(RssmConfig(channels=32), A)
    with torch.no_grad():
        assert paper.embed(torch.zeros(1, 3, 64, 64)).shape == (1, 1024)
    assert paper.cell.weight_hh.shape == (600, 200)


def test_the_prior_does_not_see_the_frame_that_the_posterior_sees(model: Rssm) -> None:
    images = batch()
    changed = images.images.clone()
    changed[:, 2] *= -1
    one, other = (model.filtered(model.embed(x), images.action) for x in (images.images, changed))
    assert torch.equal(one.prior.mean[:, :3], other.prior.mean[:, :3])
    assert not torch.equal(one.prior.mean[:, 3], other.prior.mean[:, 3])
    assert torch.equal(one.posterior.mean[:, :2], other.posterior.mean[:, :2])
    assert not torch.equal(one.posterior.mean[:, 2], other.posterior.mean[:, 2])


def test_a_state_is_drawn_around_the_mean_or_is_the_mean(model: Rssm) -> None:
    embedded, action = model.embed(batch(1).images), batch(1).action
    noise = torch.randn(B, 1, S)
    drawn, mean = model.filtered(embedded, action, noise), model.filtered(embedded, action)
    assert torch.equal(mean.state, mean.posterior.mean)
    torch.testing.assert_close(drawn.state, drawn.posterior.mean + drawn.posterior.std * noise)


def test_imagination_is_the_prior_rolled_out(model: Rssm) -> None:
    state, belief, actions = torch.randn(B, S), torch.randn(B, D), torch.rand(B, L, A)
    states, beliefs = model.imagined(state, belief, actions)
    for t in range(L):
        belief = model.advanced(state, belief, actions[:, t])
        state = model.prior(belief).mean
        torch.testing.assert_close(beliefs[:, t], belief)
        torch.testing.assert_close(states[:, t], state)


def loss_of(model: Rssm, images: Sequences, **keys: float) -> tuple[float, dict[str, Tensor]]:
    loss, parts = elbo_loss(model, images, torch.zeros(B, L, S), ElboConfig(**keys))  # type: ignore[arg-type]
    return loss.item(), parts


def test_the_loss_is_the_error_of_images_and_the_divergence(model: Rssm) -> None:
    images = batch()
    found = model.filtered(model.embed(images.images), images.action)
    error = model.decode(found.state, found.belief) - images.images
    image = 0.5 * error.square().sum() / (B * L)
    kl = gaussian_kl(found.posterior, found.prior)
    free, scaled = loss_of(model, images, free_nats=0.0), loss_of(model, images, kl_scale=0.0)
    assert free[1]["image"].item() == pytest.approx(image.item(), rel=1e-5)
    assert free[1]["kl"].item() == pytest.approx(kl.mean().item(), rel=1e-4)
    assert free[0] == pytest.approx((image + kl.mean()).item(), rel=1e-5)
    assert scaled[0] == pytest.approx(image.item(), rel=1e-5)


def test_a_divergence_below_the_free_nats_has_no_gradient() -> None:
    torch.manual_seed(0)
    model, images = Rssm(SMALL_RSSM, A), batch()
    above, below = (loss_of(model, images, free_nats=x) for x in (0.0, 50.0))
    assert below[0] - below[1]["image"].item() == pytest.approx(50, abs=1e-3)
    assert above[1]["kl"].item() < 50
    for free, moves in ((0.0, True), (50.0, False)):
        model.zero_grad()
        elbo_loss(model, images, torch.zeros(B, L, S), ElboConfig(free_nats=free))[0].backward()
        gradient = model.get_parameter("to_prior.2.weight").grad
        assert gradient is not None  # the prior is in no other term
        assert bool(gradient.any()) == moves


def test_frames_that_are_not_there_cost_nothing(model: Rssm) -> None:
    images = batch()
    known = images.known.clone()
    known[1, 2:] = False
    short = Sequences(images.images.clone(), images.action, known)
    before = loss_of(model, short)[0]
    short.images[1, 2:] = 0.5
    assert loss_of(model, short)[0] == before
    assert mean_of(torch.tensor([[1.0, 2.0, 30.0]]), torch.tensor([[True, True, False]])) == 1.5
