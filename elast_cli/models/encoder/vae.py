"""β-VAE: φ as the mean of an approximate posterior, trained with a decoder; h_f learns beside it.

An ablation of the paper (its App. D.1) compares such latents with those of CPC. Nothing here is
stored: methods take φ and h_f alone, as after training on Eq. 4.
"""

from __future__ import annotations

from itertools import pairwise

from torch import Tensor, nn

from elast_cli.models.encoder.config import SMALLEST, EncoderConfig
from elast_cli.models.encoder.cpc import Representation, rollout
from elast_cli.models.nets import mlp


class BetaVae(nn.Module):
    """φ and h_f, with what trains φ: the posterior's deviation and a decoder."""

    def __init__(self, model: Representation) -> None:
        super().__init__()
        self.model = model
        config = model.encoder.config
        self.log_variance = nn.Linear(config.width, config.latent_size)
        self.decoder = decoder(config)

    def posterior(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance [M,Z] on normalised frames [M,F,3,S,S]; the mean is φ's latent."""
        hidden = self.model.encoder.hidden(frames)
        return self.model.encoder.latent(hidden), self.log_variance(hidden).float()


def decoder(config: EncoderConfig) -> nn.Sequential:
    """The mirror image of φ: latents [M,Z] to normalised frames as one vector [M,F·3·S·S]."""
    channels, latent, width = 3 * config.frames, config.latent_size, config.width
    if config.architecture == "pooled-mlp":
        return mlp([latent, width, width, channels * config.side**2])
    outwards = [*reversed(config.conv_channels), channels]
    layers: list[nn.Module] = [nn.Unflatten(1, (outwards[0], SMALLEST, SMALLEST))]
    for inner, outer in pairwise(outwards):
        layers += [nn.ReLU(), nn.ConvTranspose2d(inner, outer, 4, stride=2, padding=1)]
    dense = mlp([latent, width, outwards[0] * SMALLEST**2])
    return nn.Sequential(*dense, *layers, nn.Flatten())


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL divergence of N(mean, exp(log_variance)) from N(0, 1), summed over Z: [M] from [M,Z]."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(1)


def vae_loss(
    vae: BetaVae, features: Tensor, actions: Tensor, context: Tensor, noise: Tensor, beta: float
) -> tuple[Tensor, dict[str, Tensor]]:
    """Negative evidence bound with weight β, plus h_f's error on latents that it cannot change.

    Args:
        vae: φ, h_f and decoder.
        features: preprocessed stacks [M, k+1, F, 3, S, S].
        actions: [M, k, A].
        context: [M, C].
        noise: standard normal [M·(k+1), Z].
        beta: weight of the divergence.
    """
    frames = vae.model.encoder.seen(features.flatten(0, 1))
    mean, log_variance = vae.posterior(frames)
    decoded = vae.decoder(mean + (0.5 * log_variance).exp() * noise).float()
    reconstruction = 0.5 * (decoded - frames.flatten(1)).square().sum(1).mean()
    kl = divergence(mean, log_variance).mean()
    z = mean.detach().unflatten(0, features.shape[:2])
    _, consistency = rollout(vae.model.dynamics, z, actions, context)
    parts = {"reconstruction": reconstruction, "kl": kl, "consistency": consistency}
    return reconstruction + beta * kl + consistency, parts
