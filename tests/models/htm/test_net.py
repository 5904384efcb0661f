"""HTM's score and inverse model: by hand, and on worlds whose answer is known."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor, nn

from elast_cli.models.cvae.config import CvaeConfig
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.htm.config import HtmConfig
from elast_cli.models.htm.net import Htm, InverseModel, Score, contrast

TINY = CvaeConfig(latent_size=2, channels=1, pool=4)


@torch.no_grad()
def test_the_score_is_a_bilinear_form_over_the_scale() -> None:
    score = Score(HtmConfig(score_scale=10), TINY, 1)
    assert 0 <= float(score.bilinear.min()) <= float(score.bilinear.max()) <= 1
    score.bilinear[:] = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    e, e_next = torch.tensor([[1.0, 0.0], [0.0, 2.0]]), torch.tensor([[1.0, 1.0], [5.0, 0.0]])
    # row 1 · W = [1, 2], row 2 · W = [6, 8]
    assert score(e, e_next).flatten().tolist() == pytest.approx([0.3, 0.5, 1.4, 3.0])
    assert score.of_pairs(e, e_next).tolist() == pytest.approx([0.3, 3.0])


def test_the_contrast_of_one_positive_is_cross_entropy_by_hand() -> None:
    positive = torch.tensor([[1.0, 0.0]])
    negative = torch.tensor([[[0.0, 2.0], [0.0, 0.0]]])
    first = -math.log(math.e / (math.e + 1 + math.e**2))
    assert float(contrast(positive, negative)) == pytest.approx((first + math.log(3)) / 2)


def around(angle: Tensor) -> Tensor:
    """Places on a circle [...,2]."""
    return torch.stack([angle.cos(), angle.sin()], dim=-1)


def test_info_nce_scores_the_next_state_above_all_others() -> None:
    """A state on a circle moves on by a twelfth; negatives lie anywhere."""
    torch.manual_seed(0)
    config = CvaeConfig(latent_size=12, channels=1, pool=4)
    score = Score(HtmConfig(score_scale=1), config, 1)
    encoder = nn.Sequential(nn.Linear(2, 32), nn.ReLU(), nn.Linear(32, 12))
    optimizer = torch.optim.Adam([score.bilinear, *encoder.parameters()], lr=1e-2)
    turn = 2 * math.pi / 12

    def scores(angle: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
        before, after = encoder(around(angle)), encoder(around(angle + turn))
        return score.of_pairs(before, after), score(before, encoder(around(others)))

    for _ in range(200):
        angle, others = 2 * math.pi * torch.rand(64), 2 * math.pi * torch.rand(50)
        optimizer.zero_grad()
        contrast(*scores(angle, others)).backward()
        optimizer.step()
    clock = turn * torch.arange(12)
    with torch.no_grad():
        places = encoder(around(clock))
        found = score(places, places)
    assert found.argmax(1).tolist() == [*range(1, 12), 0]


def test_the_inverse_model_finds_the_action_of_a_linear_system() -> None:
    torch.manual_seed(0)
    model = InverseModel(HtmConfig(width=16, depth=2), TINY, 1, 2)
    moves = torch.tensor([[0.6, 0.1], [-0.2, 0.5]])

    def system(count: int) -> tuple[Tensor, Tensor, Tensor]:
        state, action = torch.randn(count, 2), 1.8 * torch.rand(count, 2) - 0.9
        return state, state + action @ moves, action

    optimizer = torch.optim.Adam(model.head.parameters(), lr=5e-3)
    for _ in range(500):
        before, after, action = system(128)
        optimizer.zero_grad()
        (model(before, after) - action).square().mean().backward()
        optimizer.step()
    model.eval()
    before, after, action = system(500)
    error = (model(before, after) - action).square().mean()
    assert float(error.detach()) < 0.05 * float(action.var())


def test_both_encoders_begin_as_that_of_the_autoencoder() -> None:
    torch.manual_seed(0)
    cvae = Cvae(TINY, has_context=True).eval()
    model = Htm(HtmConfig(width=4, depth=1), TINY, 3, has_context=True).eval()
    images, context = torch.rand(2, 5, 3, 16, 16)
    expected = cvae.posterior(images, context).mean
    for encoder in (model.score.encoder, model.inverse.encoder):
        assert not torch.equal(encoder(images, context), expected)
    model.begin_as(cvae.encoder)
    for encoder in (model.score.encoder, model.inverse.encoder):
        assert torch.equal(encoder(images, context), expected)
    with torch.no_grad():
        cvae.encoder.mean.bias.add_(1)
    assert not torch.equal(cvae.encoder.mean.bias, model.score.encoder.mean.bias)
