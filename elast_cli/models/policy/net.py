"""Local policy π: the action that takes one latent to the next (Sec. 4.4)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from elast_cli.models.nets import LatentScale, QuantileTable, mlp
from elast_cli.models.policy.config import PolicyConfig


class LocalPolicy(nn.Module):
    """π(z, z', c): action in [-1, 1]^A, trained on observed one-step transitions."""

    def __init__(
        self, config: PolicyConfig, latent_size: int, action_size: int, context_size: int
    ) -> None:
        """Build a network of two hidden layers; scale and quantiles are set by training.

        Args:
            config: width.
            latent_size: Z.
            action_size: A.
            context_size: C; 0 where a task has no context.
        """
        super().__init__()
        self.config = config
        self.action_size = action_size
        self.scale = LatentScale(latent_size)
        self.net = mlp([2 * latent_size + context_size, config.width, config.width, action_size])
        self.round_trip_quantiles = QuantileTable()

    def forward(self, z: Tensor, z_next: Tensor, context: Tensor) -> Tensor:
        """Action [M,A] that leads from z to z'.

        Args:
            z: latents f32 [M,Z].
            z_next: z', latents f32 [M,Z].
            context: f32 [M,C].

        Returns:
            f32 [M,A] in [-1, 1].
        """
        step = (z_next - z) / self.scale.step
        out: Tensor = self.net(torch.cat([self.scale(z), step, context], dim=1))
        return torch.tanh(out.float())
