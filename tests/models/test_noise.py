"""Noise for ψ: on the data's sheet, near its source, and the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from elast_cli.models import noise as module
from elast_cli.models.noise import FEWEST, Noise

RADIUS = 0.5


@pytest.fixture
def sheet() -> Tensor:
    """3,000 latents [N,3] of the unit square, and as many far away, all at height 0."""
    flat = torch.from_numpy(np.random.default_rng(0).random((6000, 3), dtype=np.float32))
    flat[3000:, 0] += 100
    flat[:, 2] = 0
    return flat


def noise(z: Tensor, *, near: int, train: Tensor | None = None, radius: float = RADIUS) -> Noise:
    """Eight false successors of each, some of them from near by."""
    rows = torch.arange(len(z)) if train is None else train
    rng = np.random.default_rng(1)
    return Noise(z, rows, std=torch.full((3,), 0.1), ratio=8, near=near, radius=radius, rng=rng)


def test_near_noise_lies_on_the_sheet_or_beside_it_and_the_rest_around_the_source(
    sheet: Tensor,
) -> None:
    rows = torch.arange(0, 6000, 7)
    drawn = noise(sheet, near=6).draw(rows, np.random.default_rng(2))
    assert drawn.shape == (8, len(rows), 3)
    beside, on, about = drawn[:3], drawn[3:6], drawn[6:]
    assert (on[..., 2] == 0).all()
    assert ((on - sheet[rows]).norm(dim=-1) <= RADIUS + 1e-5).all()
    assert (beside[..., 2] != 0).all()
    assert 0.005 < beside[..., 2].std() < 0.1
    assert about[..., 2].std() == pytest.approx(0.1, rel=0.1)
    assert (about - sheet[rows]).std() == pytest.approx(0.1, rel=0.1)


def test_neighbours_fill_the_whole_radius(sheet: Tensor) -> None:
    source = torch.tensor([[0.5, 0.5, 0.0]])
    z = torch.cat([sheet, source])
    drawn = noise(z, near=8).draw(torch.full((500,), 6000), np.random.default_rng(2))[4:]
    gap = (drawn - source).norm(dim=-1)
    assert gap.max() <= RADIUS + 1e-5
    assert gap.median() == pytest.approx(RADIUS / 2**0.5, rel=0.15)  # uniform over a disc


def test_a_lonely_latent_gets_the_nearest_there_are(sheet: Tensor) -> None:
    lonely = torch.tensor([[50.0, 0.0, 0.0]])
    z = torch.cat([sheet, lonely])
    drawn = noise(z, near=8).draw(torch.full((200,), 6000), np.random.default_rng(2))[4:]
    assert len(drawn.reshape(-1, 3).unique(dim=0)) == FEWEST
    assert ((drawn - lonely).norm(dim=-1) < 51).all()


def test_noise_comes_from_training_rows_alone(sheet: Tensor) -> None:
    train = torch.arange(0, 3000, 2)
    drawn = noise(sheet, near=8, train=train).draw(train, np.random.default_rng(2))[4:]
    allowed = {tuple(row) for row in sheet[train].tolist()}
    assert {tuple(row) for row in drawn.reshape(-1, 3).tolist()} <= allowed


def test_without_neighbours_it_is_gaussian(sheet: Tensor) -> None:
    drawn = noise(sheet, near=0).draw(torch.arange(6000), np.random.default_rng(2))
    assert drawn.shape == (8, 6000, 3)
    assert ((drawn - sheet) / 0.1).std() == pytest.approx(1, rel=0.02)


def test_the_same_seed_draws_the_same_also_from_few_latents(
    sheet: Tensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = torch.arange(100)
    draws = [noise(sheet, near=4).draw(rows, np.random.default_rng(5)) for _ in range(2)]
    assert torch.equal(*draws)
    monkeypatch.setattr(module, "POOL", 10)  # fewer than are kept
    assert noise(sheet, near=4).draw(rows, np.random.default_rng(5)).shape == (8, 100, 3)
