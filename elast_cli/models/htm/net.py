"""Connectivity of images and inverse model of HTM (Liu et al. 2020)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from elast_cli.models.cvae.config import CvaeConfig, images_seen
from elast_cli.models.cvae.net import Embedding, GaussianEncoder
from elast_cli.models.htm.config import HtmConfig

SLOPE = 0.2  # of the leaky ReLU in the inverse model, as in the authors' code


class Score(nn.Module):
    """s(o, o') = e(o)ᵀ W e(o') / scale: log density ratio of o' after o, up to a constant."""

    def __init__(self, config: HtmConfig, cvae: CvaeConfig, images: int) -> None:
        """Untrained.

        Args:
            config: the score's scale.
            cvae: shape of its encoder.
            images: seen beside each other as channels.
        """
        super().__init__()
        self.scale = config.score_scale
        self.encoder = Embedding(cvae, images)
        self.bilinear = nn.Parameter(torch.rand(cvae.latent_size, cvae.latent_size))

    def forward(self, e: Tensor, e_next: Tensor) -> Tensor:
        """Scores [...,M,N] of all pairs of embeddings [...,M,Z] and [...,N,Z]."""
        return (e @ self.bilinear) @ e_next.transpose(-1, -2) / self.scale

    def of_pairs(self, e: Tensor, e_next: Tensor) -> Tensor:
        """Scores [...] of embeddings [...,Z] and those beside them [...,Z]."""
        return ((e @ self.bilinear) * e_next).sum(-1) / self.scale


class InverseModel(nn.Module):
    """The action in [-1, 1]^A that leads from one image to the next."""

    def __init__(self, config: HtmConfig, cvae: CvaeConfig, images: int, action: int) -> None:
        """Untrained.

        Args:
            config: hidden layers.
            cvae: shape of its encoder.
            images: seen beside each other as channels.
            action: numbers of an action, A.
        """
        super().__init__()
        self.encoder = Embedding(cvae, images)
        widths = config.layers(cvae.latent_size)
        layers: list[nn.Module] = []
        for inner, outer in pairwise(widths):
            layers += [nn.Linear(inner, outer), nn.BatchNorm1d(outer), nn.LeakyReLU(SLOPE)]
        self.head = nn.Sequential(*layers, nn.Linear(widths[-1], action))

    def forward(self, e: Tensor, e_next: Tensor) -> Tensor:
        """Embeddings [M,Z] and [M,Z] -> actions [M,A]."""
        out: Tensor = self.head(torch.cat([e, e_next], dim=1))
        return torch.tanh(out.float())


class Htm(nn.Module):
    """Both networks. They share no weight, so that they train as if each were alone."""

    def __init__(
        self, config: HtmConfig, cvae: CvaeConfig, action: int, *, has_context: bool
    ) -> None:
        """Untrained.

        Args:
            config: shape of both networks.
            cvae: shape of their encoders.
            action: numbers of an action, A.
            has_context: whether each image comes with its context image.
        """
        super().__init__()
        images = images_seen(has_context=has_context)
        self.action_size = action
        self.score = Score(config, cvae, images)
        self.inverse = InverseModel(config, cvae, images, action)

    def begin_as(self, encoder: GaussianEncoder) -> None:
        """Begin with the weights of the autoencoder's encoder, in both encoders."""
        for own in (self.score.encoder, self.inverse.encoder):
            names = own.state_dict().keys()
            own.load_state_dict({k: v for k, v in encoder.state_dict().items() if k in names})


def contrast(positive: Tensor, negative: Tensor) -> Tensor:
    """InfoNCE of one positive against N negatives: scalar, a mean over all pairs.

    Args:
        positive: scores [...].
        negative: scores of the same images with negatives [...,N].
    """
    logits = torch.cat([positive[..., None], negative], dim=-1).flatten(0, -2)
    return functional.cross_entropy(logits, torch.zeros_like(logits[:, 0], dtype=torch.long))
