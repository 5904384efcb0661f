"""Sequences of frames and actions from a dataset."""

from __future__ import annotations

import numpy as np
import torch

from elast_cli.data.dataset import Dataset
from elast_cli.data.images import blocks
from elast_cli.models.frames import collected
from elast_cli.models.part import Setting
from elast_cli.models.rssm.elbo import Sequences
from elast_cli.models.rssm.images import dequantised, quantised
from elast_cli.shapes import Int64


class SequenceData:
    """A dataset's frames in five bits, taken as sequences.

    Frames show all that there is, obstacles included.
    """

    def __init__(self, dataset: Dataset, setting: Setting) -> None:
        """Read all frames once."""
        self._setting = setting
        parts = (quantised(torch.from_numpy(block)) for _, block in blocks(dataset.pixels))
        self._codes = collected(parts, len(dataset.pixels), setting)
        action = np.nan_to_num(dataset.action)  # an episode's last row has none
        self._actions = torch.from_numpy(action).to(setting.device)
        self._last = (dataset.ep_offset + dataset.ep_len - 1)[dataset.episode]  # [N]

    def rows(self, first: Int64, length: int) -> tuple[Int64, np.ndarray]:
        """Rows [B,L] from each first row [B] on, and which of them the episode has: bool [B,L].

        Past the end of the episode its last row repeats.
        """
        steps = first[:, None] + np.arange(length)
        last = self._last[first][:, None]
        return np.minimum(steps, last), steps <= last

    def take(
        self, first: Int64, length: int, generator: torch.Generator | None = None
    ) -> Sequences:
        """Sequences of `length` frames.

        Args:
            first: rows of their first frames, i64 [B].
            length: frames of a sequence.
            generator: adds noise below a grey level of five bits to the images; None: no noise.
        """
        rows, known = self.rows(first, length)
        device = self._setting.device
        index = torch.from_numpy(rows).to(device)
        action = torch.zeros(*rows.shape, self._actions.shape[1], device=device)
        action[:, 1:] = self._actions[index[:, :-1]]
        images = dequantised(self._codes.take(rows), generator)
        return Sequences(images, action, torch.from_numpy(known).to(device))


def sequence_starts(dataset: Dataset, episodes: Int64, length: int) -> Int64:
    """First rows of all sequences of `length` frames in some episodes.

    An episode that is shorter has one sequence, from its first row on.

    Args:
        dataset: with the episodes.
        episodes: numbers of some of them, i64 [E].
        length: frames of a sequence.

    Returns:
        Rows i64 [M].
    """
    rows = [
        dataset.ep_offset[e] + np.arange(max(1, dataset.ep_len[e] - length + 1)) for e in episodes
    ]
    return np.concatenate([np.empty(0, np.int64), *rows])
