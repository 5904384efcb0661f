"""Windows of states from a dataset: frames preprocessed once, stacked by index."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.data.images import blocks
from elast_cli.models.frames import Frames, collected
from elast_cli.models.nets import PooledImages
from elast_cli.models.part import Setting
from elast_cli.shapes import FRAMES, Bool, Int64


def frame_features(dataset: Dataset, net: PooledImages, setting: Setting) -> Frames:
    """A dataset's frames as φ takes them [N,3,S,S]: preprocessed, less their context image."""
    return collected(_features(dataset, net), len(dataset.pixels), setting)


def _features(dataset: Dataset, net: PooledImages) -> Iterator[Tensor]:
    """The same, block by block."""
    for rows, pixels in blocks(dataset.pixels):
        features = net.preprocess(torch.from_numpy(pixels))
        if dataset.context is not None:
            episode = dataset.episode[rows]
            shown = dataset.context[episode[0] : episode[-1] + 1]
            images = net.preprocess(torch.from_numpy(shown))
            features -= images[torch.from_numpy(episode - episode[0])]
        elif net.pool == 1:
            features = features.byte()  # half the bytes, the same numbers
        yield features


class FrameWindows:
    """Windows of states from a dataset: frames preprocessed once, stacked by index."""

    def __init__(self, dataset: Dataset, features: Frames, context: Tensor) -> None:
        """Take a dataset, its frames [N,3,S,S] and contexts [E,C], on the training's device."""
        self.features, self.context = features, context
        self.actions = torch.from_numpy(dataset.action).to(context.device)
        self.episode = dataset.episode  # [N]
        self.first = dataset.ep_offset[self.episode]  # [N]

    def stacks(self, rows: Int64, still: Bool | None = None) -> Tensor:
        """Preprocessed stacks [M,...,F,3,S,S] of the states at `rows` [M,...].

        Where `still` [M,...] is set, the state's own frame stands in all places, as in a goal.
        """
        back = np.arange(1 - FRAMES, 1)
        if still is not None:
            back = np.where(still[..., None], 0, back)
        index = np.maximum(rows[..., None] + back, self.first[rows][..., None])
        return self.features.take(index)

    def contexts(self, rows: Int64) -> Tensor:
        """Context vectors [M,C] of the episodes that `rows` [M] lie in."""
        return self.context[torch.from_numpy(self.episode[rows]).to(self.context.device)]

    def window(
        self, rows: Int64, horizon: int, still: Bool | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """States [M,k+1,...], actions [M,k,A] and contexts [M,C] from each of `rows` on."""
        steps = rows[:, None] + np.arange(horizon + 1)
        actions = self.actions[torch.from_numpy(steps[:, :-1]).to(self.actions.device)]
        return self.stacks(steps, still), actions, self.contexts(rows)
