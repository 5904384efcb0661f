"""Policy and values of implicit Q-learning, trained together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.func import functional_call

from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.goal_policy.net import GoalPolicy
from elast_cli.models.part import Sizes

CRITICS = 2  # the smaller of two Q counts: one alone overestimates


class Critics(nn.Module):
    """Networks with one output each and normalised layers, on the same inputs."""

    def __init__(self, layers: Sequence[int], count: int) -> None:
        super().__init__()
        self.nets = nn.ModuleList(_normalized(layers) for _ in range(count))

    def forward(self, x: Tensor) -> Tensor:
        """Inputs [M,in] -> [count,M]."""
        return torch.stack([net(x).float()[:, 0] for net in self.nets])


def _normalized(layers: Sequence[int]) -> nn.Sequential:
    """A ReLU network with layer normalisation, which keeps values from diverging."""
    found: list[nn.Module] = []
    for inner, outer in pairwise(layers[:-1]):
        found += [nn.Linear(inner, outer), nn.LayerNorm(outer), nn.ReLU()]
    return nn.Sequential(*found, nn.Linear(layers[-2], layers[-1]))


class GoalIql(nn.Module):
    """π, V(z, g, c), two Q(z, a, g, c), and slow averages of the latter as targets."""

    def __init__(self, policy: GoalPolicy, critic: GoalNetConfig, sizes: Sizes) -> None:
        """Build V and both Q beside a policy; the targets are copies of the critics.

        Args:
            policy: π, which is trained with them; its scale standardises their inputs, too.
            critic: width and depth of V and of each Q.
            sizes: of latents, actions and contexts.
        """
        super().__init__()
        self.policy = policy
        inputs = 2 * sizes.latent + sizes.context
        self.value = Critics(critic.layers(inputs, 1), 1)
        self.critics = Critics(critic.layers(inputs + sizes.action, 1), CRITICS)
        self.targets = deepcopy(self.critics).requires_grad_(False)

    def values(self, z: Tensor, goal: Tensor, context: Tensor) -> Tensor:
        """V [M] of latents and goals [M,Z] in contexts [M,C].

        Args:
            z: latents f32 [M,Z].
            goal: latents f32 [M,Z].
            context: f32 [M,C].

        Returns:
            f32 [M], estimates of minus the discounted number of steps to the goal.
        """
        found: Tensor = self.value(self._inputs(z, goal, context))[0]
        return found

    def q(self, z: Tensor, action: Tensor, goal: Tensor, context: Tensor) -> Tensor:
        """Both Q [2,M] of actions [M,A].

        Args:
            z: latents f32 [M,Z].
            action: f32 [M,A] in [-1, 1].
            goal: latents f32 [M,Z].
            context: f32 [M,C].
        """
        found: Tensor = self.critics(self._inputs(z, goal, context, action))
        return found

    def target_q(self, z: Tensor, action: Tensor, goal: Tensor, context: Tensor) -> Tensor:
        """Both Q [2,M] of the targets.

        Arguments as in `GoalIql.q`.
        """
        found: Tensor = self.targets(self._inputs(z, goal, context, action))
        return found

    def fixed_q(self, z: Tensor, action: Tensor, goal: Tensor, context: Tensor) -> Tensor:
        """Both Q [2,M], whose slopes go to the actions and not to the critics.

        Arguments as in `GoalIql.q`.
        """
        weights: Mapping[str, Tensor] = {k: v.detach() for k, v in self.critics.named_parameters()}
        inputs = self._inputs(z, goal, context, action)
        found: Tensor = functional_call(self.critics, dict(weights), (inputs,))
        return found

    def _inputs(self, z: Tensor, goal: Tensor, *beside: Tensor) -> Tensor:
        scale = self.policy.scale
        return torch.cat([scale(z), scale(goal), *beside], dim=1)

    @torch.no_grad()
    def follow(self, rate: float) -> None:
        """Move the targets towards the critics by a share `rate` of what they differ."""
        for slow, fast in zip(self.targets.parameters(), self.critics.parameters(), strict=True):
            slow.lerp_(fast, rate)
