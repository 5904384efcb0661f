"""Context autoencoder: raw images of what is constant in an episode to small vectors (Sec. 5)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.data.images import Images, blocks
from elast_cli.models.context.config import SMALLEST, ContextConfig
from elast_cli.models.nets import PooledImages
from elast_cli.shapes import Float32, Uint8


class ContextAutoencoder(PooledImages):
    """Context image [64,64,3] -> code [C] -> image; standardised codes are the context vectors.

    Strided convolutions (kernel 4, stride 2, doubling channels) from S x S, S = 64 / pool, down to
    4 x 4, and back. Images are normalised by the mean image and one deviation for all pixels, so
    that who always answers with the mean image has a mean squared error of 1.
    """

    code_mean: Tensor
    code_std: Tensor

    def __init__(self, config: ContextConfig) -> None:
        super().__init__(config.pool)
        self.config = config
        self.register_buffer("code_mean", torch.zeros(config.latent_size))
        self.register_buffer("code_std", torch.ones(config.latent_size))
        widths, side = [3], self.side
        while side > SMALLEST:
            widths.append(config.channels * 2 ** (len(widths) - 1))
            side //= 2
        down: list[nn.Module] = []
        up: list[nn.Module] = []
        for outer, inner in pairwise(widths):
            down += [nn.Conv2d(outer, inner, 4, stride=2, padding=1), nn.ReLU()]
            up = [nn.ReLU(), nn.ConvTranspose2d(inner, outer, 4, stride=2, padding=1), *up]
        inner_shape = (widths[-1], SMALLEST, SMALLEST)
        flat = widths[-1] * SMALLEST**2
        self.down = nn.Sequential(*down, nn.Flatten(), nn.Linear(flat, config.latent_size))
        self.up = nn.Sequential(
            nn.Linear(config.latent_size, flat), nn.Unflatten(1, inner_shape), *up
        )

    def fit_codes(self, codes: Tensor) -> None:
        """Set mean and deviation of codes [N,C]; a dimension that hardly varies stays small."""
        std = codes.std(0, correction=0)
        self.code_mean.copy_(codes.mean(0))
        self.code_std.copy_(std.clamp_min(max(1e-3 * float(std.max()), 1e-6)))

    def code(self, features: Tensor) -> Tensor:
        """Preprocessed images [N,3,S,S] -> codes [N,C]."""
        found: Tensor = self.down(self.normalized(features))
        return found.float()

    def decode(self, code: Tensor) -> Tensor:
        """Codes [N,C] -> normalised images [N,3,S,S]."""
        image: Tensor = self.up(code)
        return image.float()

    def forward(self, features: Tensor) -> Tensor:
        """Preprocessed images [N,3,S,S] -> context vectors [N,C]."""
        return (self.code(features) - self.code_mean) / self.code_std


def reconstruction_error(model: ContextAutoencoder, features: Tensor) -> Tensor:
    """Mean squared error, in normalised units, of reconstructing images [N,3,S,S]: scalar."""
    return (model.decode(model.code(features)) - model.normalized(features)).square().mean()


@torch.inference_mode()
def context_vectors(model: ContextAutoencoder, images: Images) -> Float32:
    """Context vectors [N,C] of raw images u8 [N,64,64,3]; a row depends on its image alone."""
    rows = [
        model(model.preprocess(image))
        for _, block in blocks(images)
        for image in torch.from_numpy(block).to(model.mean.device).split(1)
    ]
    return torch.cat(rows).cpu().numpy()


@torch.inference_mode()
def reconstructions(model: ContextAutoencoder, images: Uint8) -> Uint8:
    """What the autoencoder makes of raw images u8 [N,64,64,3]: u8 [N,S,S,3]."""
    features = model.preprocess(torch.from_numpy(images).to(model.mean.device))
    grey = model.decode(model.code(features)) * model.scale + model.mean
    found: Uint8 = grey.clamp(0, 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    return np.ascontiguousarray(found)
