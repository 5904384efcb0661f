"""Datasets of episodes: one HDF5 shard each while collecting, one flat HDF5 file after that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
