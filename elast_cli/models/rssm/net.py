"""Recurrent state-space model: a belief with a deterministic and a stochastic part.

h_t = f(h_{t-1}, s_{t-1}, a_{t-1}), prior p(s_t | h_t), posterior q(s_t | h_t, o_t), and the image
p(o_t | h_t, s_t) (Hafner et al. 2019, Sec. 3 and App. A).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from elast_cli.models.nets import QuantileTable, mlp
from elast_cli.models.rssm.config import DECODING, ENCODING, RssmConfig


class Gaussian(NamedTuple):
    """Diagonal Gaussians: means and standard deviations [...,S]."""

    mean: Tensor
    std: Tensor

    def sample(self, noise: Tensor | None) -> Tensor:
        """The point that white noise [...,S] stands for; without noise the mean."""
        return self.mean if noise is None else self.mean + self.std * noise


class Beliefs(NamedTuple):
    """Beliefs at each of L frames of B sequences.

    `belief` is h [B,L,D], `state` is s [B,L,S]: drawn from the posterior, or its mean.
    """

    prior: Gaussian
    posterior: Gaussian
    belief: Tensor
    state: Tensor


class Rssm(nn.Module):
    """PlaNet's model on images [N,3,64,64] in [-0.5, 0.5]; their likelihood has unit variance.

    Strided convolutions without padding (kernel 4) lead to 2 x 2, and transposed ones back.
    """

    def __init__(self, config: RssmConfig, action: int) -> None:
        super().__init__()
        self.config, self.action_size = config, action
        self.encoder = nn.Sequential(*_convolutions(config), nn.Flatten())
        self.decoder = nn.Sequential(
            nn.Linear(config.stochastic + config.belief, config.embedded),
            nn.Unflatten(-1, (config.embedded, 1, 1)),
            *_transposed(config),
        )
        self.enter = nn.Linear(config.stochastic + action, config.hidden)
        self.cell = nn.GRUCell(config.hidden, config.belief)
        ends = [config.hidden, 2 * config.stochastic]
        self.to_prior = mlp([config.belief, *ends])
        self.to_posterior = mlp([config.belief + config.embedded, *ends])
        self.step_length_quantiles = QuantileTable()

    def start(self, count: int) -> tuple[Tensor, Tensor]:
        """State [count,S] and belief [count,D] before the first frame: zero."""
        like = self.enter.weight
        return (
            like.new_zeros(count, self.config.stochastic),
            like.new_zeros(count, self.config.belief),
        )

    def advanced(self, state: Tensor, belief: Tensor, action: Tensor) -> Tensor:
        """The next h, f32 [M,D].

        Args:
            state: s, f32 [M,S].
            belief: h, f32 [M,D].
            action: f32 [M,A].
        """
        entered = torch.relu(self.enter(torch.cat([state, action], dim=1)))
        found: Tensor = self.cell(entered, belief)
        return found.float()

    def prior(self, belief: Tensor) -> Gaussian:
        """p(s | h) from h [...,D]."""
        return self._gaussian(self.to_prior(belief))

    def posterior(self, belief: Tensor, embedded: Tensor) -> Gaussian:
        """q(s | h, o) from h [...,D] and the encoded image [...,E]."""
        return self._gaussian(self.to_posterior(torch.cat([belief, embedded], dim=-1)))

    def embed(self, images: Tensor) -> Tensor:
        """Images [...,3,64,64], encoded one by one: [...,E]."""
        found: Tensor = self.encoder(images.flatten(0, -4))
        embedded: Tensor = found.float().unflatten(0, images.shape[:-3])
        return embedded

    def decode(self, state: Tensor, belief: Tensor) -> Tensor:
        """Means of images [...,3,64,64] of s [...,S] and h [...,D]."""
        features = torch.cat([state, belief], dim=-1)
        found: Tensor = self.decoder(features.flatten(0, -2))
        images: Tensor = found.float().unflatten(0, features.shape[:-1])
        return images

    def filtered(self, embedded: Tensor, action: Tensor, noise: Tensor | None = None) -> Beliefs:
        """Beliefs at all frames of B sequences, from one frame to the next.

        Args:
            embedded: encoded images [B,L,E].
            action: that led to each image [B,L,A]; zero where nothing did.
            noise: of the states drawn [B,L,S]; without it they are the means of the posterior.
        """
        state, belief = self.start(len(embedded))
        steps = []
        for t in range(embedded.shape[1]):
            belief = self.advanced(state, belief, action[:, t])
            posterior = self.posterior(belief, embedded[:, t])
            state = posterior.sample(None if noise is None else noise[:, t])
            steps.append((belief, state, *posterior))
        beliefs, states, mean, std = (torch.stack(x, dim=1) for x in zip(*steps, strict=True))
        return Beliefs(self.prior(beliefs), Gaussian(mean, std), beliefs, states)

    def imagined(self, state: Tensor, belief: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """States [M,H,S] and beliefs [M,H,D] that actions [M,H,A] lead to, by means of the prior.

        Args:
            state: s [M,S] to begin with.
            belief: h [M,D] to begin with.
            actions: in [-1, 1].
        """
        states, beliefs = [], []
        for t in range(actions.shape[1]):
            belief = self.advanced(state, belief, actions[:, t])
            state = self.prior(belief).mean
            states.append(state)
            beliefs.append(belief)
        return torch.stack(states, dim=1), torch.stack(beliefs, dim=1)

    def _gaussian(self, out: Tensor) -> Gaussian:
        mean, raw = out.float().chunk(2, dim=-1)
        return Gaussian(mean, functional.softplus(raw) + self.config.min_std)


def _convolutions(config: RssmConfig) -> list[nn.Module]:
    """From a frame to 2 x 2."""
    layers: list[nn.Module] = []
    for outer, inner in pairwise(config.down):
        layers += [nn.Conv2d(outer, inner, ENCODING, stride=2), nn.ReLU()]
    return layers


def _transposed(config: RssmConfig) -> list[nn.Module]:
    """From 1 x 1 to a frame."""
    layers: list[nn.Module] = []
    for side, (inner, outer) in zip(DECODING, pairwise(config.up), strict=True):
        layers += [nn.ConvTranspose2d(inner, outer, side, stride=2), nn.ReLU()]
    return layers[:-1]
