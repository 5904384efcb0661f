"""Frames of five bits, as PlaNet takes them (Hafner et al. 2019, App. A; Kingma and Dhariwal 2018).

A colour of 0 to 255 becomes one of 32 codes. The model sees (code + noise) / 32 - 0.5 with noise
uniform in [0, 1), so that no density of a pixel is infinite. Noise is 0.5 outside of training.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.shapes import Uint8

BITS = 5
CODES = 1 << BITS


def quantised(pixels: Tensor) -> Tensor:
    """Frames u8 [N,64,64,3] as codes u8 [N,3,64,64] of 0 to 31."""
    return (pixels >> (8 - BITS)).permute(0, 3, 1, 2).contiguous()


def dequantised(codes: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Codes u8 as float32 in [-0.5, 0.5]: with noise of a generator on their device, or without."""
    values = codes.float()
    if generator is None:
        values += 0.5
    else:
        values += torch.rand(values.shape, generator=generator, device=values.device)
    return values.div_(CODES).sub_(0.5)


def grey_levels(images: Tensor) -> Tensor:
    """Images in [-0.5, 0.5] in grey levels of 0 to 255, not rounded."""
    return ((images + 0.5) * 256 - 0.5).clamp(0, 255)


def shown(images: Tensor) -> Uint8:
    """Images [N,3,64,64] for people: u8 [N,64,64,3]."""
    found = grey_levels(images).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    return np.ascontiguousarray(found)
