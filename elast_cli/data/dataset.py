"""Datasets of episodes: several small files during collection, one file afterwards.

A shard is a dataset of consecutive episodes; both have the layout of `layout`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elast_cli import seeding
from elast_cli.data import layout
from elast_cli.data.images import Images
from elast_cli.errors import DataError


@dataclass(frozen=True)
class Episode:
    """One episode of T steps, hence T + 1 rows; `action[t]` leads from row t to row t + 1.

    pixels      u8  [T+1, 64, 64, 3]
    action      f32 [T+1, A]  in the action box; the last row is NaN: nothing follows it
    state       f32 [T+1, S]  true simulator state, for probes and reports only
    context     u8  [H, W, 3] raw image of what is constant in the episode, or None
    seed_index  the i of `seeding.generator("collect", seed, i)` that made it
    """

    pixels: NDArray[np.uint8]
    action: NDArray[np.float32]
    state: NDArray[np.float32]
    context: NDArray[np.uint8] | None
    seed_index: int


@dataclass(frozen=True)
class Dataset:
    """Episodes 0 .. E-1 end to end, N rows in all; numbers in memory, images perhaps on disk.

    pixels     u8  [N, 64, 64, 3]
    action     f32 [N, A]  NaN in each episode's last row
    state      f32 [N, S]
    ep_len     i32 [E]     rows of each episode, at least 2
    ep_offset  i64 [E]     its first row
    context    u8  [E, H, W, 3] or None
    """

    pixels: Images
    action: NDArray[np.float32]
    state: NDArray[np.float32]
    ep_len: NDArray[np.int32]
    ep_offset: NDArray[np.int64]
    context: Images | None

    @classmethod
    def load(cls, path: Path) -> Dataset:
        """The dataset in an untrusted file; images are read on access.

        Raises:
            DataError: the file is unsafe, damaged or inconsistent; names the episode if it can.
        """
        contents = layout.read(path)
        if contents.first_episode != 0:
            raise DataError(f"{path}: begins with episode {contents.first_episode}, not 0")
        return cls(pixels=contents.pixels, context=contents.context, **contents.numbers)

    @property
    def episodes(self) -> int:
        """Number of episodes E."""
        return len(self.ep_len)

    def split(
        self, fraction: float = 0.1, seed: int = 0
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Sorted episode numbers for training and for validation, some of each.

        Raises:
            DataError: there is only one episode.
        """
        if self.episodes < 2:
            raise DataError("a dataset of one episode cannot be split; collect more (--n)")
        held_out = min(max(round(fraction * self.episodes), 1), self.episodes - 1)
        shuffled = seeding.generator("train", seed, self.episodes).permutation(self.episodes)
        return np.sort(shuffled[held_out:]), np.sort(shuffled[:held_out])

    def starts(self, episodes: NDArray[np.int64], horizon: int) -> NDArray[np.int64]:
        """All rows t of the given episodes such that t .. t + horizon lie in one episode."""
        ranges = [
            np.arange(self.ep_offset[e], self.ep_offset[e] + self.ep_len[e] - horizon)
            for e in episodes
        ]
        return np.concatenate([np.empty(0, np.int64), *ranges])

    @cached_property
    def episode(self) -> NDArray[np.int64]:
        """The episode that each row lies in [N]."""
        return np.repeat(np.arange(self.episodes), self.ep_len)
