"""Implicit Q-learning against expectiles, and against values of a ring worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import expectile as scipy_expectile

from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.goal_policy.data import GoalData
from elast_cli.models.goal_policy.gciql.config import GciqlSection, IqlConfig
from elast_cli.models.goal_policy.gciql.net import GoalIql
from elast_cli.models.goal_policy.gciql.objective import (
    Aimed,
    critic_loss,
    expectile_loss,
    policy_loss,
)
from elast_cli.models.goal_policy.gciql.training import train_gciql, untrained
from elast_cli.models.part import FitConfig
from elast_cli.shapes import Float64
from tests.toys.goals import goal_data, setting

STATES, DISCOUNT = 5, 0.9
NET = GoalNetConfig(width=32, depth=1)


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_the_minimiser_of_the_loss_is_the_expectile(share: float) -> None:
    samples = np.random.default_rng(0).exponential(size=2000)
    estimate = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([estimate], max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        loss = expectile_loss(torch.from_numpy(samples) - estimate, share)
        loss.backward()
        return loss

    optimizer.step(closure)
    assert estimate.item() == pytest.approx(scipy_expectile(samples, share), rel=1e-4)
    if share == 0.5:
        assert estimate.item() == pytest.approx(samples.mean(), rel=1e-4)


def test_two_outcomes_have_the_expectile_that_weighs_them() -> None:
    """Of 0 and 1, equally likely, it is the weight itself: τ (1 - m) = (1 - τ) m."""
    outcomes = torch.tensor([0.0, 1.0])
    at = torch.linspace(0, 1, 101)
    losses = torch.stack([expectile_loss(outcomes - m, 0.9) for m in at])
    assert at[losses.argmin()].item() == pytest.approx(0.9)


# --- a ring of states, one-hot --------------------------------------------------------------------


def ring(steps: Float64) -> GoalData:
    """Walks on a ring by steps [E,T] of 1 or -1, which are the actions, too."""
    place = np.cumsum(np.pad(steps, ((0, 0), (1, 0)))[:, :-1], axis=1).astype(int)
    start = np.arange(len(steps))[:, None]
    return goal_data(np.eye(STATES)[(place + start) % STATES], steps[..., None])


def section(steps: int, **changes: float) -> GciqlSection:
    keys = {"discount": DISCOUNT, "target_rate": 0.05, **changes}
    fit = FitConfig(steps=steps, batch_size=64, learning_rate=5e-3, log_every=steps)
    return GciqlSection(net=NET, critic=NET, iql=IqlConfig.model_validate(keys), fit=fit)


def values(model: GoalIql) -> Float64:
    """V from state 0 to each state [STATES]."""
    z = torch.eye(STATES)
    with torch.no_grad():
        found = model.values(z[:1].expand(STATES, -1), z, torch.zeros(STATES, 0))
    return found.double().numpy()


def trained(
    data: GoalData, of: GciqlSection, work: Path, monkeypatch: pytest.MonkeyPatch
) -> GoalIql:
    """All networks after training; what is kept of them is the policy alone."""
    model, spec = untrained(data, of, setting(work))
    at = "elast_cli.models.goal_policy.gciql.training.untrained"
    monkeypatch.setattr(at, lambda *_: (model, spec))
    kept = train_gciql(data, of, setting(work))
    assert kept.module is model.policy
    return model


def test_values_of_a_one_way_ring_are_the_discounted_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = trained(ring(np.ones((30, 12))), section(500), tmp_path, monkeypatch)
    by_hand = [0, -1, -1.9, -2.71, -3.439]  # -(1 - 0.9^d) / (1 - 0.9)
    np.testing.assert_allclose(values(model), by_hand, atol=0.2)


def test_values_and_policy_of_random_walks_on_a_ring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two equally likely actions V is τ times the better Q and 1 - τ times the worse one."""
    steps = np.random.default_rng(0).choice([-1.0, 1.0], (120, 12))
    model = trained(ring(steps), section(900, expectile=0.8), tmp_path, monkeypatch)
    exact = np.zeros(STATES)  # by how far the goal is to the right
    for _ in range(200):
        right, left = (DISCOUNT * np.roll(exact, by) - 1 for by in (1, -1))
        exact = 0.8 * np.maximum(right, left) + 0.2 * np.minimum(right, left)
        exact[0] = 0
    np.testing.assert_allclose(values(model), exact, atol=0.35)
    z = torch.eye(STATES)
    action = model.policy(z[:1].expand(2, -1), z[[1, 4]], torch.zeros(2, 0)).detach()
    assert action[0].item() > 0.5
    assert action[1].item() < -0.5


# --- each objective -------------------------------------------------------------------------------


def items(model: GoalIql, arrived: list[bool]) -> Aimed:
    """Transitions, all alike but for their arrival."""
    count = len(arrived)
    z = torch.randn(1, STATES).expand(count, -1)
    return Aimed(
        z=z,
        action=torch.full((count, 1), 0.5),
        z_next=-z,
        goal=torch.ones(count, STATES),
        context=torch.zeros(count, 0),
        arrived=torch.tensor(arrived),
    )


@pytest.fixture
def model(tmp_path: Path) -> GoalIql:
    return untrained(ring(np.ones((10, 6))), section(1), setting(tmp_path))[0]


def test_the_critics_go_for_zero_at_the_goal_and_for_one_step_more_elsewhere(
    model: GoalIql,
) -> None:
    for arrived in (True, False):
        item = items(model, [arrived])
        following = model.values(item.z_next, item.goal, item.context)
        wanted = 0 if arrived else DISCOUNT * following - 1
        q = model.q(item.z, item.action, item.goal, item.context)
        expected = (q - wanted).square().sum()
        torch.testing.assert_close(critic_loss(model, item, section(1).iql), expected)


def test_the_policys_loss_moves_the_policy_alone(model: GoalIql) -> None:
    loss, error = policy_loss(model, items(model, [False] * 3), section(1).iql)
    loss.backward()
    assert all(p.grad is None for net in (model.critics, model.value) for p in net.parameters())
    assert all(p.grad is not None for p in model.policy.parameters())
    assert error.item() >= 0


def test_cloning_weighs_what_it_is_told_to(model: GoalIql) -> None:
    item = items(model, [False] * 3)
    found = {
        weight: policy_loss(model, item, section(1, bc_weight=weight).iql) for weight in (0.0, 2.0)
    }
    likelihood = 0.5 * found[0.0][1]  # one action dimension
    torch.testing.assert_close(found[2.0][0] - found[0.0][0], 2 * likelihood)


def test_targets_follow_the_critics(model: GoalIql) -> None:
    with torch.no_grad():
        for p in model.critics.parameters():
            p.fill_(1)
        for p in model.targets.parameters():
            p.fill_(0)
    model.follow(0.25)
    model.follow(0.25)
    for p in model.targets.parameters():
        torch.testing.assert_close(p, torch.full_like(p, 1 - 0.75**2))
