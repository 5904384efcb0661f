"""Frames of a dataset beside their context images, in [0, 1]."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.models.frames import Frames, image_features
from elast_cli.models.nets import Pooling
from elast_cli.models.part import Setting
from elast_cli.shapes import Int64, Uint8


@dataclass(frozen=True)
class ImagePairs:
    """Frames by row, each with the context image of its episode.

    Attributes:
        frames: of the dataset, pooled.
        contexts: one an episode, or None.
        episode: that each row lies in [N].
    """

    frames: Frames
    contexts: Frames | None
    episode: Int64

    @classmethod
    def of(cls, dataset: Dataset, net: Pooling, setting: Setting) -> ImagePairs:
        """Those of a dataset.

        Args:
            dataset: with frames u8 [N,64,64,3], and context images where there are any.
            net: says how they are pooled.
            setting: device, folder, and the memory that images may use.
        """
        images = dataset.context
        contexts = None if images is None else image_features(images, net, setting)
        return cls(image_features(dataset.pixels, net, setting), contexts, dataset.episode)

    def take(self, rows: Int64) -> tuple[Tensor, Tensor]:
        """Images [M,3,S,S] at `rows` [M] and their context images [M,0 or 3,S,S]."""
        images = unit(self.frames.take(rows))
        if self.contexts is None:
            return images, images[:, :0]
        return images, unit(self.contexts.take(self.episode[rows]))


def unit(features: Tensor) -> Tensor:
    """Brightness 0 to 255 as float32 in [0, 1]."""
    return features.float() / 255


def as_bytes(images: Tensor) -> Uint8:
    """Images [M,3,S,S] in [0, 1] as u8 [M,S,S,3]."""
    grey = (255 * images).round().clamp(0, 255).to(torch.uint8)
    found: Uint8 = grey.permute(0, 2, 3, 1).contiguous().cpu().numpy()
    return found
