"""Cloned policies and inverse dynamics against worlds whose actions are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.models.goal_policy.cloning import Cloning
from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.goal_policy.gcbc.config import GcbcSection
from elast_cli.models.goal_policy.gcbc.training import train_gcbc
from elast_cli.models.goal_policy.gcidm.config import GcidmConfig, GcidmSection
from elast_cli.models.goal_policy.gcidm.training import train_gcidm
from elast_cli.models.part import FitConfig
from elast_cli.shapes import Int64
from tests.toys.goals import goal_data, setting

FIT = FitConfig(steps=500, batch_size=128, learning_rate=5e-3, log_every=500)
MOVES = np.array([[0.5, 0.2], [-0.3, 0.4]])  # B of z' = z + B a


def test_cloning_recovers_a_linear_expert(tmp_path: Path) -> None:
    """The expert's one step K (g - z) leads to the goal, where it stays."""
    rng, gain = np.random.default_rng(0), np.linalg.inv(MOVES)
    action = np.zeros((400, 4, 2))
    action[:, 0] = rng.uniform(-0.8, 0.8, (400, 2))
    start = rng.uniform(-1, 1, (400, 1, 2))
    z = np.concatenate([start, (start[:, 0] + action[:, 0] @ MOVES.T)[:, None].repeat(3, 1)], 1)
    section = GcbcSection(net=GoalNetConfig(width=48, depth=2), fit=FIT)
    trained = train_gcbc(goal_data(z, action), section, setting(tmp_path))
    new = rng.uniform(-0.6, 0.6, (200, 2))
    here = rng.uniform(-0.8, 0.8, (200, 2))
    there = here + new @ MOVES.T
    found = trained.module(*(torch.from_numpy(x).float() for x in (here, there, here[:, :0])))
    expert = (there - here) @ gain.T
    np.testing.assert_allclose(expert, new, atol=1e-12)
    assert np.abs(found.detach().numpy() - expert).mean() < 0.03
    assert trained.metrics["val_action_r2"] > 0.98


def test_inverse_dynamics_recovers_the_actions_of_a_linear_system(tmp_path: Path) -> None:
    """From z' = z + B a: one step has the action B⁻¹ Δ, and h of them the mean B⁻¹ Δ / h."""
    rng = np.random.default_rng(0)
    action = rng.uniform(-1, 1, (400, 8, 2))
    moved = np.cumsum(action @ MOVES.T, axis=1)
    z = rng.uniform(-1, 1, (400, 1, 2)) + np.concatenate([0 * moved[:, :1], moved[:, :-1]], 1)
    net = GcidmConfig(width=64, depth=2, longest=4)
    trained = train_gcidm(goal_data(z, action), GcidmSection(net=net, fit=FIT), setting(tmp_path))
    here = rng.uniform(-1, 1, (200, 2))
    for steps, tolerance in ((1, 0.06), (2, 0.1), (4, 0.1)):
        mean = rng.uniform(-0.6, 0.6, (200, 2)) / steps**0.5
        there = here + steps * mean @ MOVES.T
        items = here, there, np.full((200, 1), 1 / steps)
        found = trained.module(*(torch.from_numpy(x).float() for x in items))
        assert np.abs(found.detach().numpy() - mean).mean() < tolerance, steps


def test_a_constant_policy_explains_nothing() -> None:
    data = goal_data(np.zeros((20, 5, 1)), np.random.default_rng(0).uniform(-1, 1, (20, 5, 3)))
    action = data.latents.action
    mean = action[data.latents.train].mean(0)
    cloning = Cloning(data.train, lambda rows, _goals, _rng: mean.expand(len(rows), 3), action)
    error = cloning.error(data.train.starts, np.random.default_rng(0))
    assert float(error) == pytest.approx(cloning.variance(), rel=1e-5)
    assert cloning.variance() == pytest.approx(1 / 3, rel=0.2)  # of the uniform distribution


def test_goals_are_as_far_as_the_objective_says() -> None:
    data = goal_data(np.zeros((3, 9, 1)), np.zeros((3, 9, 1)))
    ahead: list[int] = []

    def predict(rows: Int64, goals: Int64, _rng: np.random.Generator) -> torch.Tensor:
        ahead.extend((goals - rows).tolist())
        return torch.zeros(len(rows), 1)

    for longest, most in ((None, 8), (2, 2)):
        ahead.clear()
        rows = data.train.rows(np.random.default_rng(0), 400)
        cloning = Cloning(data.train, predict, data.latents.action, longest)
        cloning.error(rows, np.random.default_rng(0))
        assert set(ahead) == set(range(1, most + 1))
