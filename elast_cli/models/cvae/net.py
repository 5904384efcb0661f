"""Conditional variational autoencoder of HTM (Liu et al. 2020): it generates the map's images."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from elast_cli.models.cvae.config import INNERMOST, CvaeConfig, images_seen
from elast_cli.models.nets import Pooling

SLOPE = 0.1  # of the leaky ReLU in convolutions, as in the authors' code


class Gaussian(NamedTuple):
    """Independent normal distributions: means and logarithms of variances [M,Z]."""

    mean: Tensor
    log_variance: Tensor

    def at(self, noise: Tensor) -> Tensor:
        """Samples [M,Z] from standard normal noise [M,Z]."""
        return self.mean + noise * (0.5 * self.log_variance).exp()


def divergence(q: Gaussian, p: Gaussian) -> Tensor:
    """KL divergence of q from p in nats: [M]."""
    spread = (q.log_variance - p.log_variance).exp()
    shift = (q.mean - p.mean).square() * (-p.log_variance).exp()
    return 0.5 * (p.log_variance - q.log_variance + spread + shift - 1).sum(1)


class Embedding(nn.Module):
    """Strided convolutions with batch normalisation: images beside each other -> [M,Z]."""

    def __init__(self, config: CvaeConfig, images: int) -> None:
        super().__init__()
        widths = [3 * images, *config.conv_channels]
        layers: list[nn.Module] = [nn.BatchNorm2d(widths[0])]
        for inner, outer in pairwise(widths):
            layers += [nn.Conv2d(inner, outer, 4, stride=2, padding=1)]
            layers += [nn.BatchNorm2d(outer), nn.LeakyReLU(SLOPE)]
        self.body = nn.Sequential(*layers, nn.Flatten())
        self.mean = nn.Linear(config.flat, config.latent_size)

    def forward(self, images: Tensor, context: Tensor) -> Tensor:
        """Images [M,3,S,S] in [0, 1] and their context images [M,0 or 3,S,S] -> [M,Z]."""
        found: Tensor = self.mean(self.body(torch.cat([images, context], dim=1)))
        return found.float()


class GaussianEncoder(Embedding):
    """The same, whose embedding is the mean of a distribution."""

    def __init__(self, config: CvaeConfig, images: int) -> None:
        super().__init__(config, images)
        self.log_variance = nn.Linear(config.flat, config.latent_size)

    def gaussian(self, images: Tensor, context: Tensor) -> Gaussian:
        """The distribution of latents [M,Z] of images and context images."""
        body = self.body(torch.cat([images, context], dim=1))
        return Gaussian(self.mean(body).float(), self.log_variance(body).float())


class Cvae(Pooling):
    """p(o | z) p(z | c) with the approximate posterior q(z | o, c); o and c are single images.

    The decoder sees z alone, as in the authors' code. Without contexts, p(z) is standard normal.
    `steps` counts the gradient steps of its training, so that one that resumes goes on with them.
    """

    steps: Tensor

    def __init__(self, config: CvaeConfig, *, has_context: bool) -> None:
        super().__init__(config.pool)
        self.config, self.has_context = config, has_context
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))
        self.encoder = GaussianEncoder(config, images_seen(has_context=has_context))
        self.prior = GaussianEncoder(config, 1) if has_context else None
        widths = [*reversed(config.conv_channels), 3]
        layers: list[nn.Module] = []
        for inner, outer in pairwise(widths):
            layers += [nn.BatchNorm2d(inner), nn.ReLU()] if layers else []
            layers += [nn.ConvTranspose2d(inner, outer, 4, stride=2, padding=1)]
        self.decoder = nn.Sequential(
            nn.Linear(config.latent_size, config.flat),
            nn.Unflatten(1, (widths[0], INNERMOST, INNERMOST)),
            *layers,
        )

    def posterior(self, images: Tensor, context: Tensor) -> Gaussian:
        """q(z | o, c) of images [M,3,S,S] and context images [M,0 or 3,S,S], in [0, 1]."""
        return self.encoder.gaussian(images, context)

    def prior_of(self, context: Tensor) -> Gaussian:
        """p(z | c) of context images [M,0 or 3,S,S]."""
        if self.prior is None:
            nothing = context.new_zeros(len(context), self.config.latent_size)
            return Gaussian(nothing, nothing)
        return self.prior.gaussian(context, context[:, :0])

    def logits(self, z: Tensor) -> Tensor:
        """Logits [M,3,S,S] of the images that latents [M,Z] stand for."""
        found: Tensor = self.decoder(z)
        return found.float()

    def images(self, z: Tensor) -> Tensor:
        """The images [M,3,S,S] in [0, 1] of latents [M,Z]."""
        return self.logits(z).sigmoid()

    def reconstructed(self, images: Tensor, context: Tensor) -> Tensor:
        """Images [M,3,S,S] decoded from their mean latents."""
        return self.images(self.encoder(images, context))


def negative_elbo(
    model: Cvae, images: Tensor, context: Tensor, noise: Tensor, kl_weight: float
) -> tuple[Tensor, dict[str, Tensor]]:
    """The objective: scalar, a mean over images, and its parts in nats an image.

    Args:
        model: the autoencoder.
        images: [M,3,S,S] in [0, 1].
        context: context images [M,0 or 3,S,S].
        noise: standard normal [M,Z].
        kl_weight: weight of the divergence from the prior.
    """
    posterior = model.posterior(images, context)
    logits = model.logits(posterior.at(noise))
    pixels = functional.binary_cross_entropy_with_logits(logits, images, reduction="none")
    bce, kl = pixels.flatten(1).sum(1).mean(), divergence(posterior, model.prior_of(context)).mean()
    return bce + kl_weight * kl, {"bce": bce, "kl": kl}
