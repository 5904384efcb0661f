"""Pairs of images, one to a few steps apart, and generated images in their contexts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.models.cvae.images import ImagePairs
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.cvae.training import normal
from elast_cli.models.htm.config import PairConfig
from elast_cli.shapes import Int64


@dataclass(frozen=True)
class Pairs:
    """G groups of M pairs, each group in one context, with N negatives a group.

    Attributes:
        images: frames before and after a step, and context images, each [2GM,3 or 0,S,S].
        shown: reconstructions of these frames and then negatives [2GM+GN,3,S,S].
        shown_context: context images of all of them [2GM+GN,3 or 0,S,S].
        action: that was taken [GM,A].
        groups: G.
    """

    images: tuple[Tensor, Tensor]
    shown: Tensor
    shown_context: Tensor
    action: Tensor
    groups: int


@dataclass(frozen=True)
class PairSource:
    """Where pairs come from.

    Attributes:
        dataset: episodes.
        pairs: its images.
        cvae: the trained autoencoder, which reconstructs and generates.
        config: which pairs.
    """

    dataset: Dataset
    pairs: ImagePairs
    cvae: Cvae
    config: PairConfig

    def rows(self, starts: Int64, rng: np.random.Generator, size: int) -> tuple[Int64, int]:
        """Rows of first images [GM], group by group, and the number G of groups.

        Args:
            starts: rows [K] in order from which `ahead` steps lie in one episode.
            rng: chooses them.
            size: of a batch, which is cut to whole groups.
        """
        if self.pairs.contexts is None:
            return starts[rng.integers(len(starts), size=size)], 1
        each = min(self.config.per_context, size)
        groups = size // each
        episode = self.dataset.episode[starts]
        picked = episode[rng.integers(len(starts), size=groups)]
        first, end = np.searchsorted(episode, picked), np.searchsorted(episode, picked, "right")
        place = rng.integers(first[:, None], end[:, None], size=(groups, each))
        found: Int64 = starts[place].ravel()
        return found, groups

    @torch.no_grad()
    def batch(self, starts: Int64, rng: np.random.Generator, size: int) -> Pairs:
        """A batch of pairs, with reconstructions and negatives.

        Args:
            starts: rows that may begin a pair, i64 [N].
            rng: draws pairs, distances and noise.
            size: pairs of the batch, about; see `rows`.
        """
        rows, groups = self.rows(starts, rng, size)
        after = rows + rng.integers(1, self.config.ahead + 1, size=len(rows))
        images, context = self.pairs.take(np.concatenate([rows, after]))
        latent, device = self.cvae.config.latent_size, images.device
        noise = normal(rng, (len(images), latent)).to(device)
        seen = self.cvae.images(self.cvae.posterior(images, context).at(noise))
        anchors = context[: len(rows) : len(rows) // groups]
        around = anchors.repeat_interleave(self.config.negatives, 0)
        noise = normal(rng, (groups * self.config.negatives, latent)).to(device)
        made = self.cvae.images(self.cvae.prior_of(around).at(noise))
        action = torch.from_numpy(self.dataset.action[rows]).to(device)
        return Pairs(
            images=(images, context),
            shown=torch.cat([seen, made]),
            shown_context=torch.cat([context, around]),
            action=action,
            groups=groups,
        )
