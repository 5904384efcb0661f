"""Objectives of goal-conditioned implicit Q-learning.

V is an expectile of Q over the actions of the data. So the values never depend on actions outside
the data (Kostrikov et al., 2022). The policy climbs Q and stays near the data (DDPG+BC).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from elast_cli.models.goal_policy.gciql.config import IqlConfig
from elast_cli.models.goal_policy.gciql.net import GoalIql


@dataclass(frozen=True)
class Aimed:
    """Transitions with goals.

    Attributes:
        z, action, z_next: latents [M,Z], actions [M,A], next latents [M,Z].
        goal, context: goals [M,Z] and contexts [M,C].
        arrived: whether a transition starts at its goal [M].
    """

    z: Tensor
    action: Tensor
    z_next: Tensor
    goal: Tensor
    context: Tensor
    arrived: Tensor


def expectile_loss(excess: Tensor, expectile: float) -> Tensor:
    """Asymmetric squared error of `excess` [M], sample less estimate: scalar.

    Positive excesses weigh `expectile`, the others 1 - `expectile`. The minimiser is the expectile
    of the samples; 0.5 gives their mean, and towards 1 it approaches their maximum.
    """
    weight = torch.where(excess > 0, expectile, 1 - expectile)
    return (weight * excess.square()).mean()


def value_loss(model: GoalIql, items: Aimed, config: IqlConfig) -> Tensor:
    """V towards the expectile of the smaller target Q: scalar.

    Args:
        model: V and the targets.
        items: M transitions with goals for values.
        config: gives the expectile.
    """
    with torch.no_grad():
        q = model.target_q(items.z, items.action, items.goal, items.context).amin(0)
    return expectile_loss(q - model.values(items.z, items.goal, items.context), config.expectile)


def critic_loss(model: GoalIql, items: Aimed, config: IqlConfig) -> Tensor:
    """Both Q towards 0 at the goal, else towards -1 + γ V(z', g): scalar.

    Args:
        model: V and the critics.
        items: M transitions with goals for values.
        config: gives the discount γ.
    """
    with torch.no_grad():
        following = model.values(items.z_next, items.goal, items.context)
        wanted = (config.discount * following - 1) * (~items.arrived)
    q = model.q(items.z, items.action, items.goal, items.context)
    return (q - wanted).square().mean(1).sum()


def policy_loss(model: GoalIql, items: Aimed, config: IqlConfig) -> tuple[Tensor, Tensor]:
    """DDPG+BC: the smaller Q of the policy's action, in units of its mean size, and cloning.

    Args:
        model: the policy and the critics.
        items: M transitions with goals for the policy.
        config: gives the weight of cloning.

    Returns:
        The loss and the mean squared error of the actions: scalars.
    """
    action = model.policy(items.z, items.goal, items.context)
    q = model.fixed_q(items.z, action, items.goal, items.context).amin(0)
    error = (action - items.action).square()
    clone = 0.5 * error.sum(1).mean()  # a Gaussian of variance 1, up to a constant
    size = q.detach().abs().mean().clamp_min(1e-6)
    return config.bc_weight * clone - q.mean() / size, error.mean()
