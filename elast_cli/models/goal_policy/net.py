"""Goal-conditioned policy on latents."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.nets import LatentScale, mlp
from elast_cli.models.part import Sizes


class GoalPolicy(nn.Module):
    """π(z, z_g, x): mean action in [-1, 1]^A, with x the context and what else is known.

    The policy is a Gaussian of constant variance. Control takes its mean.
    """

    def __init__(self, config: GoalNetConfig, sizes: Sizes, beside: int) -> None:
        """Build the network; the scale is set by training.

        Args:
            config: width and depth.
            sizes: of latents and actions.
            beside: X, numbers given besides state and goal.
        """
        super().__init__()
        self.config = config
        self.scale = LatentScale(sizes.latent)
        self.net = mlp(config.layers(2 * sizes.latent + beside, sizes.action))

    def forward(self, z: Tensor, goal: Tensor, beside: Tensor) -> Tensor:
        """Mean action [M,A] towards a goal.

        Args:
            z: latents f32 [M,Z].
            goal: latents f32 [M,Z].
            beside: context and what else is known, f32 [M,X].

        Returns:
            f32 [M,A] in [-1, 1].
        """
        out: Tensor = self.net(torch.cat([self.scale(z), self.scale(goal), beside], dim=1))
        return torch.tanh(out.float())
