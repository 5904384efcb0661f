"""Transition density ψ by noise-contrastive estimation (Sec. 4.2)."""

from __future__ import annotations

import math

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from elast_cli.config import StrictModel
from elast_cli.models.nets import MAX_WIDTH, LatentScale, QuantileTable, mlp


class DensityConfig(StrictModel):
    """Shape of ψ and its noise; neither ν nor Σ is stated in the paper's main text.

    Where episodes differ in their context, a share `context_share` of the noise are transitions
    that fit other contexts. With such noise, up to `lent_share` of the data are transitions of
    other episodes that fit the context, too. Of the rest of the noise, a share `near_share` leads
    to latents of the data within `near_radius` (in 95 % quantiles of the lengths of steps) of the
    source. With neither, it is the paper's Gaussian noise.
    """

    width: int = Field(default=128, gt=0, le=MAX_WIDTH)
    depth: int = Field(default=2, ge=1, le=10, description="hidden layers")
    noise_ratio: int = Field(default=10, ge=1)
    noise_scale: float = Field(default=1.0, gt=0)
    near_share: float = Field(default=0.8, ge=0, le=1)
    near_radius: float = Field(default=1.25, gt=0)
    context_share: float = Field(default=0.5, ge=0, le=1)
    lent_share: float = Field(default=0.5, ge=0, le=1)

    def elsewhere(self, context_size: int) -> int:
        """How many of the ν false transitions fit other contexts, of `context_size` numbers."""
        return round(self.context_share * self.noise_ratio) if context_size else 0

    def near(self, context_size: int) -> int:
        """How many of the ν false transitions lead to latents of the data near by."""
        return round(self.near_share * (self.noise_ratio - self.elsewhere(context_size)))


def nce_loss(log_model: Tensor, log_noise: Tensor, is_data: Tensor, noise_ratio: float) -> Tensor:
    """Negative NCE objective (Eq. 2): scalar. Inputs [M] in nats; is_data bool [M]."""
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
        return self.config.near(self.context_size) + self.config.elsewhere(self.context_size) > 0

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
        """G of Eq. 1, ln p_m - ln p_n [M], from [M,Z], [M,Z], [M,C]."""
        x = torch.cat([self.scale(z), (z_next - z) / self.noise_std(), context], dim=1)
        return self.log_ratio_from_hidden(self.first(x))

    def forward(self, z: Tensor, z_next: Tensor, context: Tensor) -> Tensor:
        """Log density ln p(z' | z, c) [M] in nats, relative to the noise if part of it is data."""
        ratio = self.log_ratio(z, z_next, context)
        return ratio if self.relative else ratio + self.log_noise(z, z_next)
