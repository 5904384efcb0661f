"""Latent dynamics: the forward model h_f trained with φ, and the ensemble H_f (Sec. 4.1, 4.3)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from elast_cli.models.ensemble.config import EnsembleConfig
from elast_cli.models.nets import EnsembleLinear, LatentScale, QuantileTable


class DynamicsEnsemble(nn.Module):
    """H_f: the mean of m forward models, and their disagreement as predictive variance."""

    def __init__(
        self, config: EnsembleConfig, latent_size: int, action_size: int, context_size: int
    ) -> None:
        """Build m networks with weights of their own.

        Args:
            config: number, width and depth of the networks.
            latent_size: Z.
            action_size: A.
            context_size: C; 0 where a task has no context.
        """
        super().__init__()
        self.config = config
        n_in = latent_size + action_size + context_size
        sizes = [n_in, *[config.width] * config.depth, latent_size]
        self.scale = LatentScale(latent_size)
        self.layers = nn.ModuleList(
            EnsembleLinear(config.members, inner, outer) for inner, outer in pairwise(sizes)
        )
        self.variance_quantiles = QuantileTable()

    def members(self, z: Tensor, action: Tensor, context: Tensor) -> Tensor:
        """Every member's step in units of `scale.step`: [M,Z], ... or [E,M,Z], ... -> [E,M,Z].

        Args:
            z: latents f32 [M,Z], the same for all members, or [E,M,Z].
            action: f32 [M,A] or [E,M,A].
            context: f32 [M,C] or [E,M,C].

        Returns:
            f32 [E,M,Z], E = m.
        """
        x = torch.cat([self.scale(z), action, context], dim=-1)
        if x.dim() == 2:
            x = x.expand(self.config.members, -1, -1)
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        out: Tensor = self.layers[-1](x)
        return out.float()

    def forward(self, z: Tensor, action: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        """Mean next latent [M,Z] and the variance summed over dimensions [M], in latent units².

        Args:
            z: latents f32 [M,Z].
            action: f32 [M,A].
            context: f32 [M,C].

        Returns:
            f32 [M,Z] and f32 [M].
        """
        steps = self.members(z, action, context) * self.scale.step
        spread = (steps - steps.mean(0)).square().sum(-1).mean(0)
        return z + steps.mean(0), spread

    def by_one_member(self, z: Tensor, action: Tensor, context: Tensor) -> Tensor:
        """Next latent [M,Z], that of row i by member i mod m: for the price of a single network.

        Arguments as in `DynamicsEnsemble.forward`.
        """
        members = self.config.members
        more = torch.arange(len(z) + -len(z) % members, device=z.device) % max(1, len(z))
        parts = (x[more].unflatten(0, (-1, members)).transpose(0, 1) for x in (z, action, context))
        steps = self.members(*parts).transpose(0, 1).flatten(0, 1)[: len(z)]
        return z + steps * self.scale.step
