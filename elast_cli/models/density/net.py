"""Transition density ψ by noise-contrastive estimation (Sec. 4.2)."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from elast_cli.models.density.config import DensityConfig
from elast_cli.models.nets import LatentScale, QuantileTable, mlp


def nce_loss(log_model: Tensor, log_noise: Tensor, is_data: Tensor, noise_ratio: float) -> Tensor:
    """Negative NCE objective (Eq. 2): scalar.

    Args:
        log_model: ln p_m f32 [M], in nats.
        log_noise: ln p_n f32 [M], in nats.
        is_data: bool [M]; the others are noise.
        noise_ratio: ν, noise for each item of data.
    """
    margin = log_model - log_noise - math.log(noise_ratio)  # ln(m / (1 - m)), Eq. 1
    data = functional.softplus(-margin[is_data]).mean()
    noise = functional.softplus(margin[~is_data]).mean()
    return data + noise_ratio * noise


class TransitionDensity(nn.Module):
    """ψ: log density of a latent transition given its source, ln p(z' | z, c), in nats.

    The network's output is the log ratio to the noise. For the Gaussian N(z, Σ), Σ = diag(step²),
    ψ adds ln p_n. Noise that is partly data from near by has no known density: there the ratio
    stands, the density relative to what else lies near by. Neither the units of the latent space
    nor how the data crowd in it change it, so that one threshold fits everywhere.

    The first layer is linear in z and z', so a node's two contributions can be computed once and
    a pair costs only the later layers.
    """

    def __init__(self, config: DensityConfig, latent_size: int, context_size: int) -> None:
        """Build the layers; scale and quantiles are set by training.

        Args:
            config: width, depth and noise.
            latent_size: Z.
            context_size: C; 0 where a task has no context.
        """
        super().__init__()
        self.config = config
        self.latent_size = latent_size
        self.context_size = context_size
        self.scale = LatentScale(latent_size)
        self.first = nn.Linear(2 * latent_size + context_size, config.width)
        self.rest = nn.Sequential(nn.ReLU(), mlp([config.width] * config.depth + [1]))
        self.log_density_quantiles = QuantileTable()

    @property
    def relative(self) -> bool:
        """Whether the noise has no known density, since part of it is data."""
        return self.config.relative(self.context_size)

    def noise_std(self) -> Tensor:
        """Standard deviation [Z] of the noise about a transition's source."""
        return self.scale.step * self.config.noise_scale

    def log_noise(self, z: Tensor, z_next: Tensor) -> Tensor:
        """ln p_n(z' | z) [M] of the Gaussian noise (Fig. 3)."""
        std = self.noise_std()
        distance = ((z_next - z) / std).square().sum(-1)
        constant = 2 * torch.log(std).sum() + self.latent_size * math.log(2 * math.pi)
        return -0.5 * (distance + constant)

    def features(self, z: Tensor, context: Tensor) -> Tensor:
        """A node's part of the first layer as source, as target, and its scaled latent [M,2W+Z]."""
        w_state, w_step, w_context = self.first.weight.split(
            [self.latent_size, self.latent_size, context.shape[1]], dim=1
        )
        scaled = z / self.noise_std()
        towards = scaled @ w_step.T
        away = self.scale(z) @ w_state.T + context @ w_context.T + self.first.bias - towards
        return torch.cat([away, towards, scaled], dim=1)

    def log_ratio_from_hidden(self, hidden: Tensor) -> Tensor:
        """ln p_m - ln p_n [M] from the first layer's pre-activation [M,W]."""
        out: Tensor = self.rest(hidden)
        return out.squeeze(-1).float()

    def log_ratio(self, z: Tensor, z_next: Tensor, context: Tensor) -> Tensor:
        """G of Eq. 1, ln p_m - ln p_n [M].

        Args:
            z: sources f32 [M,Z].
            z_next: targets f32 [M,Z].
            context: f32 [M,C].

        Returns:
            f32 [M], in nats.
        """
        x = torch.cat([self.scale(z), (z_next - z) / self.noise_std(), context], dim=1)
        return self.log_ratio_from_hidden(self.first(x))

    def forward(self, z: Tensor, z_next: Tensor, context: Tensor) -> Tensor:
        """Log density ln p(z' | z, c) [M] in nats, relative to the noise if part of it is data.

        Arguments as in `TransitionDensity.log_ratio`.
        """
        ratio = self.log_ratio(z, z_next, context)
        return ratio if self.relative else ratio + self.log_noise(z, z_next)
