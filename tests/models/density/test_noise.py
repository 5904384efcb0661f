"""Noise for ψ: on the data's sheet, near its source, and the same for the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from elast_cli.models.density import noise as module
from elast_cli.models.density.noise import FEWEST, Noise, OtherContexts
from elast_cli.models.ensemble.config import EnsembleConfig
from elast_cli.models.ensemble.net import DynamicsEnsemble

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


def line_of_rooms(*, count: int) -> OtherContexts:
    """Places 0, 0.1, ..., 0.9 of a line in 20 episodes; the context is where a wall stands.

    Steps are 0.1 to the right, and by H_f end at the wall; who is beyond it stays.
    """
    place = torch.linspace(0, 0.9, 10).repeat(20)[:, None]
    wall = torch.linspace(0.05, 1, 20).repeat_interleave(10)[:, None]

    def step(z: Tensor, action: Tensor, context: Tensor) -> Tensor:
        return torch.where(z < context, torch.minimum(z + 0.1 * action, context), z)

    inside = torch.arange(200)
    train = inside[inside % 10 < 9]
    action = torch.ones(200, 1)
    return OtherContexts(place, action, wall, train, step, margin=0.01, alike=0.01, count=count)


def test_noise_of_other_contexts_crosses_walls_goes_on_beyond_them_and_was_seen_elsewhere() -> None:
    others = line_of_rooms(count=10)
    rows = torch.arange(0, 50, 10).repeat(40)  # the walls at 0.05 to 0.25, from 0
    sources, targets = others.draw(rows, rows, np.random.default_rng(0))
    assert sources.shape == targets.shape == (10, 200, 1)
    wall = others.context[rows]
    crossing = [0, 2, 4, 5]
    assert (sources[crossing] == others.z[rows]).all()
    own = others.step(others.z[rows], others.action[rows], wall)
    farther = (targets[crossing] > own + others.margin).float().mean((0, 2))
    possible = (own < 0.1 - others.margin).flatten()  # 18 of 20 walls are farther than any step
    assert farther[possible].mean() > 0.99
    assert (farther[~possible] == 0).all()
    beyond = [1, 3]
    torch.testing.assert_close(sources[beyond], targets[[0, 2]])
    assert (targets[beyond] >= sources[beyond]).all()
    seen = targets[6:] - sources[6:]
    torch.testing.assert_close(seen, torch.full_like(seen, 0.1))
    misfit = targets[6:] > wall + others.alike  # each of four tries fits in 0 to 2 of 9 cases
    assert misfit.float().mean() > 0.98


def test_noise_leaves_given_places_in_the_contexts_of_other_rows() -> None:
    others = line_of_rooms(count=5)
    places, rows = torch.full((100,), 3), torch.arange(0, 200, 10).repeat(5)
    sources, targets = others.draw(places, rows, np.random.default_rng(0))
    torch.testing.assert_close(sources[0], torch.full((100, 1), 0.3))
    barred = (others.context[rows] < 0.37).flatten()
    assert (targets[0] > others.context[rows] + others.margin)[barred].float().mean() > 0.9


def test_transitions_are_relabelled_with_contexts_that_they_fit() -> None:
    others = line_of_rooms(count=5)
    rows = torch.arange(0, 200, 10).repeat(50)
    found = others.relabelled(rows, 0.5, np.random.default_rng(0))
    own, wall = found == rows, others.context[rows].flatten()
    ends = others.z[found].flatten() + 0.1
    assert (ends <= wall + others.alike)[~own].all()
    roomy, narrow = wall > 0.9, wall < 0.15
    assert (~own)[roomy].float().mean() == pytest.approx(0.5, abs=0.1)
    assert (~own)[narrow].float().mean() < 0.1
    assert torch.isin(found, torch.cat([others.train, rows])).all()
    assert torch.equal(others.relabelled(rows, 0, np.random.default_rng(0)), rows)


def test_noise_of_other_contexts_is_the_same_for_the_same_seed_and_for_training_alone() -> None:
    others = line_of_rooms(count=5)
    rows = torch.arange(30)
    one, again = (others.draw(rows, rows, np.random.default_rng(3)) for _ in range(2))
    torch.testing.assert_close(one, again, rtol=0, atol=0)
    assert (one[0][3:] < 0.85).all()  # no episode's last place starts a transition


def test_where_no_context_gets_farther_a_false_step_is_an_ordinary_one() -> None:
    others = replace(line_of_rooms(count=5), margin=1.0)
    rows = torch.arange(0, 180, 10)
    _, targets = others.draw(rows, rows, np.random.default_rng(0))
    walls = others.context[others.train]
    assert torch.isin(targets[0], torch.cat([walls, torch.tensor([[0.1]])])).all()
    assert len(targets[0].unique()) < len(walls.unique())


def test_a_step_by_one_member_is_that_of_the_rows_own_member() -> None:
    ensemble = DynamicsEnsemble(EnsembleConfig(members=3, width=8), 4, 2, 1)
    z, action, context = torch.rand(7, 4), torch.rand(7, 2), torch.rand(7, 1)
    steps = ensemble.members(z, action, context)
    expected = torch.stack([z[i] + steps[i % 3, i] * ensemble.scale.step for i in range(7)])
    torch.testing.assert_close(ensemble.by_one_member(z, action, context), expected)
    assert ensemble.by_one_member(z[:0], action[:0], context[:0]).shape == (0, 4)
