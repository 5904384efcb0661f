"""Encoder φ: three stacked frames to a small latent state (Sec. 4.1)."""

from __future__ import annotations

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from elast_cli.config import StrictModel
from elast_cli.models.nets import MAX_WIDTH, mlp
from elast_cli.shapes import FRAMES, IMAGE_SIZE


class EncoderConfig(StrictModel):
    """Shape of φ. The paper's appendix has its sizes; these are our choice."""

    architecture: Literal["pooled-mlp", "conv"] = "pooled-mlp"
    latent_size: int = Field(default=8, gt=0, le=256)
    width: int = Field(default=128, gt=0, le=MAX_WIDTH)
    pool: Literal[1, 2, 4, 8] = 4


class Encoder(nn.Module):
    """φ: frames [..., F, 64, 64, 3] -> latent [..., Z].

    Work that depends on one frame alone is done once for a whole dataset by `preprocess`; `forward`
    then takes stacks of preprocessed frames, normalised by the training data's mean image and one
    global scale. Without that normalisation the latent collapses to one dimension.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, config: EncoderConfig, context_size: int = 0) -> None:
        super().__init__()
        self.config = config
        side = IMAGE_SIZE // config.pool
        self.register_buffer("mean", torch.zeros(3, side, side))
        self.register_buffer("scale", torch.ones(()))
        if config.architecture == "pooled-mlp":
            n_in = FRAMES * 3 * side * side + context_size
            self.net: nn.Module = mlp([n_in, config.width, config.width, config.latent_size])
        else:
            self.net = ConvStack(side, config, context_size)

    def preprocess(self, pixels: Tensor) -> Tensor:
        """Average-pool frames uint8 [N,64,64,3] to uint8-valued float16 [N,3,S,S] in [0, 255]."""
        side, pool = IMAGE_SIZE // self.config.pool, self.config.pool
        parts = [
            _block_sums(part.float(), side, pool).div_(pool * pool).half()
            for part in pixels.split(256)  # small enough to stay in the cache
        ]
        return torch.cat(parts).permute(0, 3, 1, 2).contiguous()

    def fit_normalization(self, features: Tensor) -> None:
        """Set the mean image and the global scale from preprocessed frames [N,3,S,S]."""
        sample = features.float()
        self.mean.copy_(sample.mean(0))
        self.scale.copy_((sample - self.mean).square().mean().sqrt().clamp_min(1e-3))

    def forward(self, features: Tensor, context: Tensor) -> Tensor:
        """Encode stacks [M,F,3,S,S] with contexts [M,C] to latents [M,Z]."""
        x = (features.float() - self.mean) / self.scale
        if isinstance(self.net, ConvStack):
            latent: Tensor = self.net(x.flatten(1, 2), context)
        else:
            latent = self.net(torch.cat([x.flatten(1), context], dim=1))
        return latent


def _block_sums(x: Tensor, side: int, pool: int) -> Tensor:
    """Sums over pool x pool blocks of frames [N,P·S,P·S,3]: [N,S,S,3]; rows first, for speed."""
    rows: Tensor = x.unflatten(1, (side, pool))
    columns: Tensor = rows.sum(2).unflatten(2, (side, pool))
    return columns.sum(3)


class ConvStack(nn.Module):
    """Strided convolutions (kernel 4, stride 2, doubling channels) and a two-layer head."""

    def __init__(self, side: int, config: EncoderConfig, context_size: int) -> None:
        super().__init__()
        channels, n_in = 32, FRAMES * 3
        layers: list[nn.Module] = []
        while side > 4:
            layers += [nn.Conv2d(n_in, channels, 4, stride=2, padding=1), nn.ReLU()]
            n_in, channels, side = channels, min(2 * channels, 256), side // 2
        self.body = nn.Sequential(*layers, nn.Flatten())
        self.head = mlp([n_in * side * side + context_size, config.width, config.latent_size])

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        """[M,F·3,S,S], [M,C] -> [M,Z]."""
        latent: Tensor = self.head(torch.cat([self.body(x), context], dim=1))
        return latent
