"""Encoder φ: three stacked frames to a small latent state (Sec. 4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from torch import Tensor, nn

from elast_cli.models.encoder.config import SMALLEST, EncoderConfig
from elast_cli.models.nets import PooledImages, mlp


class Encoder(PooledImages):
    """φ: frames [..., F, 64, 64, 3] -> latent [..., Z].

    Work that depends on one frame alone is done once for a whole dataset by `preprocess`; `forward`
    then takes stacks of preprocessed frames, normalised by the training data's mean image and one
    global scale, or whitened colours. Without that the latent collapses to one dimension.

    Where obstacles change with the episode, frames come less their context image: so φ depends on
    the context, and what is left of a frame is what moves.
    """

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__(config.pool, whiten=config.whiten)
        self.config = config
        side = self.side
        if config.architecture == "pooled-mlp":
            n_in = config.frames * 3 * side * side
            layers = [n_in, config.width, config.width, config.latent_size]
            self.net: nn.Sequential | ConvStack = mlp(layers)
        else:
            self.net = ConvStack(config)

    def forward(self, features: Tensor) -> Tensor:
        """Encode stacks [M,F,3,S,S] to latents [M,Z]."""
        return self.latent(self.hidden(self.seen(features)))

    def seen(self, features: Tensor) -> Tensor:
        """The normalised frames [M,F',3,S,S] of stacks [M,F,3,S,S] that φ sees."""
        return self.normalized(features[:, -self.config.frames :])

    def hidden(self, frames: Tensor) -> Tensor:
        """Last hidden layer [M,width] on normalised frames [M,F',3,S,S]."""
        if isinstance(self.net, ConvStack):
            frames = self.net.body(frames.flatten(1, 2))
        found: Tensor = self._dense[:-1](frames.flatten(1))
        return found

    def latent(self, hidden: Tensor) -> Tensor:
        """Latents [M,Z] from the last hidden layer [M,width]."""
        found: Tensor = self._dense[-1](hidden)
        return found.float()

    @property
    def _dense(self) -> nn.Sequential:
        """The dense layers."""
        return self.net.head if isinstance(self.net, ConvStack) else self.net


def convolutions(frames: int, channels: Sequence[int]) -> nn.Sequential:
    """Strided convolutions (kernel 4, stride 2) of frames [M,frames·3,S,S] to [M,flat].

    Args:
        frames: images beside each other as channels.
        channels: of each layer.
    """
    layers: list[nn.Module] = []
    for inner, outer in pairwise([3 * frames, *channels]):
        layers += [nn.Conv2d(inner, outer, 4, stride=2, padding=1), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten())


class ConvStack(nn.Module):
    """Strided convolutions with doubling channels, and a two-layer head."""

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.body = convolutions(config.frames, config.conv_channels)
        flat = config.conv_channels[-1] * SMALLEST**2
        self.head = mlp([flat, config.width, config.latent_size])

    def forward(self, x: Tensor) -> Tensor:
        """Frames beside each other as channels [M,F·3,S,S] -> [M,Z]."""
        latent: Tensor = self.head(self.body(x))
        return latent
