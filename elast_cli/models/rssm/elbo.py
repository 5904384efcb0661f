"""The evidence lower bound of sequences, with free nats (Hafner et al. 2019, Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from elast_cli.models.rssm.config import ElboConfig
from elast_cli.models.rssm.net import Gaussian, Rssm


@dataclass(frozen=True)
class Sequences:
    """B sequences of L frames.

    Attributes:
        images: [B,L,3,64,64] in [-0.5, 0.5].
        action: that led to each frame [B,L,A]; zero before the first.
        known: frames that there are bool [B,L]: an episode may end before.
    """

    images: Tensor
    action: Tensor
    known: Tensor


def gaussian_kl(one: Gaussian, other: Gaussian) -> Tensor:
    """KL(one || other) in nats [...], summed over S dimensions that are independent."""
    ratio = one.std / other.std
    apart = (one.mean - other.mean) / other.std
    return 0.5 * (ratio.square() + apart.square() - 1 - 2 * ratio.log()).sum(-1)


def elbo_loss(
    model: Rssm, batch: Sequences, noise: Tensor, config: ElboConfig
) -> tuple[Tensor, dict[str, Tensor]]:
    """The negative bound in nats a frame, up to a constant, and its parts.

    `image` is half the squared error of an image, summed over its pixels: the negative logarithm of
    a likelihood of unit variance. `kl` is the divergence of the posterior from the prior. A frame's
    divergence below `free_nats` costs as much as that, so that it has no gradient.

    Args:
        model: with its weights.
        batch: sequences.
        noise: of the states drawn [B,L,S].
        config: free nats and weight.
    """
    found = model.filtered(model.embed(batch.images), batch.action, noise)
    decoded = model.decode(found.state, found.belief)
    image = mean_of(0.5 * (decoded - batch.images).square().sum((2, 3, 4)), batch.known)
    kl = gaussian_kl(found.posterior, found.prior)
    paid = mean_of(kl.clamp_min(config.free_nats), batch.known)
    parts = {"image": image, "kl": mean_of(kl, batch.known)}
    return image + config.kl_scale * paid, parts


def mean_of(values: Tensor, known: Tensor) -> Tensor:
    """Mean of values [B,L] where they are known: scalar."""
    return torch.where(known, values, 0).sum() / known.sum()
