"""Random shifts of images, against overfitting."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.models.goal_policy.pixel_gcbc.config import ShiftConfig
from elast_cli.shapes import Int64


def shifted(images: Tensor, offsets: Int64) -> Tensor:
    """Images [M,D,S,S] moved by `offsets` [M,2] pixels down and to the right.

    The pixels of an edge are repeated into what becomes free.
    """
    side = images.shape[-1]
    place = np.clip(np.arange(side) - offsets[..., None], 0, side - 1)  # [M,2,S]
    rows, columns = torch.from_numpy(place).to(images.device).unbind(1)
    item = torch.arange(len(images), device=images.device)[:, None, None]
    moved = images.permute(0, 2, 3, 1)[item, rows[:, :, None], columns[:, None, :]]
    return moved.permute(0, 3, 1, 2)


def random_offsets(rng: np.random.Generator, count: int, config: ShiftConfig) -> Int64:
    """Offsets [count,2] in pixels, uniform up to the largest; zero for the rest of the batch.

    Args:
        rng: draws them.
        count: items of the batch.
        config: largest offset, and the share of items that are shifted.

    Returns:
        i64 [count,2].
    """
    offsets = rng.integers(-config.pixels, config.pixels + 1, size=(count, 2))
    return np.where(rng.random((count, 1)) < config.share, offsets, 0)
