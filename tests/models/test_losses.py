"""Each loss against numbers worked out by hand from the paper's equations."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from elast_cli.models.density.net import nce_loss
from elast_cli.models.encoder.config import CpcConfig, EncoderConfig
from elast_cli.models.encoder.cpc import Representation, cpc_loss, info_nce, inverse_loss
from elast_cli.models.encoder.isometry import blurred, gaussian_weights, isometry_loss


def test_nce_with_no_knowledge_costs_what_equation_2_says() -> None:
    """p_m = p_n: Eq. 1 gives m = 1 / (1 + ν) everywhere."""
    zero = torch.zeros(4)
    loss = nce_loss(zero, zero, torch.tensor([True, False, False, False]), 3.0)
    assert loss.item() == pytest.approx(-(math.log(1 / 4) + 3 * math.log(3 / 4)))


def test_nce_against_equations_1_and_2_term_by_term() -> None:
    log_model, log_noise = np.array([0.5, -1.0, 2.0, -3.0]), np.array([-0.5, -2.0, 0.0, -1.0])
    ratio, is_data = 2.0, np.array([True, True, False, False])
    model, noise = np.exp(log_model), np.exp(log_noise)
    share = model / (model + ratio * noise)  # Eq. 1
    data, other = np.log(share[:2]).mean(), np.log(1 - share[2:]).mean()
    expected = -(data + ratio * other)  # Eq. 2
    model_nats, noise_nats = torch.from_numpy(log_model), torch.from_numpy(log_noise)
    loss = nce_loss(model_nats, noise_nats, torch.from_numpy(is_data), ratio)
    assert loss.item() == pytest.approx(expected, abs=1e-12)


def test_nce_is_least_where_the_model_is_the_truth() -> None:
    """Data and noise on two cells: p = (0.8, 0.2) against (0.5, 0.5), ν = 1."""
    cells = torch.tensor([0] * 8 + [1] * 2 + [0] * 5 + [1] * 5)
    is_data = torch.arange(20) < 10
    log_noise = torch.full((20,), math.log(0.5))

    def loss(first: float) -> float:
        log_model = torch.log(torch.tensor([first, 1 - first]))[cells]
        return nce_loss(log_model, log_noise, is_data, 1.0).item()

    assert loss(0.8) < min(loss(0.7), loss(0.9), loss(0.5))


def test_nce_stays_finite_at_extreme_densities() -> None:
    extreme = torch.tensor([1e4, -1e4, 1e4, -1e4])
    loss = nce_loss(extreme, torch.zeros(4), torch.tensor([True, True, False, False]), 1.0)
    assert loss.item() == pytest.approx(1e4)


def test_info_nce_against_its_softmax_by_hand() -> None:
    prediction = torch.tensor([[0.0], [1.0]])
    future = torch.tensor([[0.0], [2.0]])  # squared distances: 0, 4 and 1, 1
    expected = -(math.log(1 / (1 + math.exp(-4))) + math.log(1 / 2)) / 2
    assert info_nce(prediction, future).item() == pytest.approx(expected, rel=1e-5)


def test_info_nce_of_predictions_that_say_nothing_is_the_log_of_the_batch() -> None:
    assert info_nce(torch.zeros(16, 2), torch.zeros(16, 2)).item() == pytest.approx(math.log(16))


class _Latent(nn.Module):
    """Encodes a stack as the first pixel of its last frame."""

    def forward(self, features: Tensor) -> Tensor:
        return features[:, -1, 0, 0, :1]


class _Add(nn.Module):
    """z + a + c."""

    def forward(self, z: Tensor, action: Tensor, context: Tensor) -> Tensor:
        return z + action + context


def toy_representation(config: CpcConfig) -> Representation:
    """A representation whose z is a pixel and whose h_f is z + a + c."""
    model = Representation(EncoderConfig(latent_size=1, width=1), config, 1, 1)
    model.encoder, model.dynamics = _Latent(), _Add()  # type: ignore[assignment]  # toys
    return model


def test_cpc_predicts_its_own_predictions_forward() -> None:
    config = CpcConfig(horizon=2, consistency_weight=0.5)
    z = torch.tensor([[0.0, 1.0, 3.0], [5.0, 5.0, 6.0]])  # [M, k+1]
    features = torch.zeros(2, 3, 3, 3, 1, 1)
    features[:, :, -1, 0, 0, 0] = z
    actions = torch.tensor([[[1.0], [1.0]], [[1.0], [0.0]]])
    context = torch.tensor([[-1.0], [-1.0]])
    # auto-regressive: 0 -> 0 -> 0 and 5 -> 5 -> 4; errors 1, 0 then 9, 4 (Eq. 4)
    consistency = (1 + 0) / 2 + (9 + 4) / 2
    logits = -np.array([[9.0, 36.0], [1.0, 4.0]])  # of predictions 0, 4 to futures 3, 6
    contrast = -np.log(np.exp(np.diag(logits)) / np.exp(logits).sum(1)).mean()
    loss, parts = cpc_loss(toy_representation(config), features, actions, context, config)
    assert parts["consistency"].item() == pytest.approx(consistency)
    assert parts["info_nce"].item() == pytest.approx(contrast, rel=1e-5)
    assert loss.item() == pytest.approx(contrast + 0.5 * consistency, rel=1e-5)


def test_all_states_of_all_windows_may_be_negatives() -> None:
    config = CpcConfig.model_validate({"horizon": 1, "negatives": "window"})
    z = torch.tensor([[0.0, 1.0], [5.0, 6.0]])  # [M, k+1]
    features = torch.zeros(2, 2, 3, 3, 1, 1)
    features[:, :, -1, 0, 0, 0] = z
    actions, context = torch.tensor([[[3.0]], [[1.0]]]), torch.full((2, 1), -1.0)
    # predictions 2 and 5 against the last states 1, 6 and the first ones 0, 5
    logits = -np.array([[1.0, 16.0, 4.0, 9.0], [16.0, 1.0, 25.0, 0.0]])
    contrast = -np.log(np.exp(np.diag(logits)) / np.exp(logits).sum(1)).mean()
    _, parts = cpc_loss(toy_representation(config), features, actions, context, config)
    assert parts["info_nce"].item() == pytest.approx(contrast, rel=1e-5)


def squares(positions: Tensor, side: int = 32) -> Tensor:
    """Pictures [..., 3, side, side] of a white square, four pixels wide, at x of [..., 2]."""
    grid = torch.arange(side, dtype=torch.float32)
    inside = [((grid - x[..., None]).abs() < 2).float() for x in positions.unbind(-1)]
    picture = inside[1][..., :, None] * inside[0][..., None, :]
    return picture.unsqueeze(-3).expand(*picture.shape[:-2], 3, side, side).contiguous()


def walks(windows: int = 32, steps: int = 4) -> Tensor:
    """Positions [M,k+1,2] of random walks, 1.5 pixels a step."""
    rng = torch.Generator().manual_seed(0)
    turn = 2 * math.pi * torch.rand(windows, steps, generator=rng)
    step = 1.5 * torch.stack([turn.cos(), turn.sin()], -1)
    return 12 + 8 * torch.rand(windows, 1, 2, generator=rng) + step.cumsum(1)


def test_distances_of_blurred_images_are_those_of_what_moves() -> None:
    at = torch.tensor([[10.0, 10.0], [11.0, 10.0], [12.0, 10.0], [10.0, 12.0], [10.0, 14.0]])
    picture = blurred(squares(at), blur=8)
    assert picture.shape == (5, 3 * 16 * 16)
    gap = (picture[0] - picture[1:]).norm(dim=1)
    assert gap[1] / gap[0] == pytest.approx(2, abs=0.1)
    assert gap[2] / gap[1] == pytest.approx(1, abs=1e-3)
    assert gap[3] / gap[2] == pytest.approx(2, abs=0.25)
    sharp = blurred(squares(at), blur=1)
    assert (sharp[0] - sharp[4]).norm() / (sharp[0] - sharp[3]).norm() < 1.6  # no more overlap


@pytest.mark.parametrize("factor", [0.1, 1, 30])
def test_latents_that_are_places_up_to_a_factor_have_hardly_any_isometry_loss(
    factor: float,
) -> None:
    at = walks()
    images = squares(at)

    def loss(z: Tensor) -> float:
        return isometry_loss(z, images, blur=8, reach=4).item()

    assert loss(factor * at) < 0.02
    assert loss(factor * at * torch.tensor([1.0, 0.1])) > 0.1
    assert loss(factor * at[..., :1]) > 0.1
    assert loss(torch.randn_like(at) * factor) > 0.2


def test_what_lies_beyond_reach_may_be_anywhere() -> None:
    at = torch.tensor([[[8.0, 8.0], [9.0, 8.0]], [[24.0, 24.0], [25.0, 24.0]]])
    images = squares(at)
    far = at + torch.tensor([0.0, 1000.0])[:, None, None]
    assert isometry_loss(far, images, blur=8, reach=3).item() < 1e-3
    assert isometry_loss(far, images, blur=8, reach=1e6).item() > 0.1


@pytest.mark.parametrize("deviation", [0.75, 1.25, 2.0, 4.0])
def test_blurring_is_gaussian_and_no_weight_is_subnormal(deviation: float) -> None:
    weight = gaussian_weights(32, deviation, torch.device("cpu"))
    apart = np.arange(32) - ((np.arange(16) + 0.5) * 2 - 0.5)[:, None]
    expected = np.exp(-0.5 * (apart / deviation) ** 2)
    expected /= expected.sum(1, keepdims=True)
    assert np.allclose(weight.numpy(), expected, rtol=1e-5, atol=1e-12)
    counted = weight[weight > 0]  # processors take 20 times as long for subnormal numbers
    assert counted.min() > torch.finfo(torch.float32).tiny * 1e6


def test_the_inverse_loss_is_the_error_of_actions_read_off_two_states() -> None:
    """z' = z + 2a, read as half the step: no error; read as the step: that of a itself."""
    actions = torch.tensor([[[0.5, -1.0], [0.25, 0.0]], [[1.0, 1.0], [-0.5, 0.5]]])
    start, context = torch.tensor([[1.0, 2.0], [-3.0, 0.0]]), torch.full((2, 1), 7.0)
    z = torch.cat([start[:, None], start[:, None] + 2 * actions.cumsum(1)], dim=1)
    for factor, expected in ((0.5, 0.0), (1.0, float(actions.square().mean()))):
        seen: list[Tensor] = []

        def read(given: Tensor, factor: float = factor, seen: list[Tensor] = seen) -> Tensor:
            seen.append(given)
            return factor * given[..., 2:4]

        assert inverse_loss(read, z, actions, context).item() == pytest.approx(expected)
        torch.testing.assert_close(seen[0][..., :2], z[:, :-1])
        assert (seen[0][..., 4] == 7).all()


def test_where_nothing_moves_there_is_no_isometry_loss() -> None:
    z = torch.randn(4, 3, 2, requires_grad=True)
    loss = isometry_loss(z, torch.ones(4, 3, 3, 16, 16), blur=5, reach=6)
    loss.backward()
    assert loss.item() == 0
    assert z.grad is not None
    assert not z.grad.any()


def test_the_isometry_loss_follows_latents_down_to_the_same_place() -> None:
    at = walks()
    z = (at[:, :1] + 0 * at).requires_grad_()  # all states of a window at one point
    loss = isometry_loss(z, squares(at), blur=8, reach=4)
    loss.backward()
    assert z.grad is not None
    assert z.grad.isfinite().all()


def test_a_perfect_model_has_no_consistency_loss() -> None:
    config = CpcConfig(horizon=1)
    features = torch.zeros(4, 2, 3, 3, 1, 1)
    features[:, 1, -1, 0, 0, 0] = torch.arange(4.0) * 10
    actions = torch.arange(4.0)[:, None, None] * 10
    zero = torch.zeros(4, 1)
    loss, parts = cpc_loss(toy_representation(config), features, actions, zero, config)
    assert parts["consistency"].item() == 0
    assert loss.item() == pytest.approx(0, abs=1e-6)
