"""Windows of states from a dataset: frames preprocessed once, stacked by index."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.models.encoder.net import Encoder
from elast_cli.shapes import FRAMES, Bool, Int64


def frame_features(dataset: Dataset, encoder: Encoder) -> Tensor:
    """A dataset's frames as φ takes them [N,3,S,S]: preprocessed, less their context image."""
    features = encoder.preprocess(torch.from_numpy(dataset.pixels))
    if dataset.context is not None:
        images = encoder.preprocess(torch.from_numpy(dataset.context))
        for part, image in zip(features.split(dataset.ep_len.tolist()), images, strict=True):
            part -= image
    return features


class FrameWindows:
    """Windows of states from a dataset: frames preprocessed once, stacked by index."""

    def __init__(self, dataset: Dataset, features: Tensor, context: Tensor) -> None:
        self.features, self.context = features, context  # [N,3,S,S], [E,C]
        self.actions = torch.from_numpy(dataset.action).to(features.device)
        self.episode = np.repeat(np.arange(dataset.episodes), dataset.ep_len)  # [N]
        self.first = dataset.ep_offset[self.episode]  # [N]

    def stacks(self, rows: Int64, still: Bool | None = None) -> Tensor:
        """Preprocessed stacks [M,...,F,3,S,S] of the states at `rows` [M,...].

        Where `still` [M,...] is set, the state's own frame stands in all places, as in a goal.
        """
        back = np.arange(1 - FRAMES, 1)
        if still is not None:
            back = np.where(still[..., None], 0, back)
        index = np.maximum(rows[..., None] + back, self.first[rows][..., None])
        return self.features[torch.from_numpy(index).to(self.features.device)]

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
