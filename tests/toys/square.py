"""A tiny world: a bright square on a dark floor, moved by its action."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from elast_cli.data.dataset import Dataset
from elast_cli.models.part import Setting
from elast_cli.progress import Silent

EPISODES, ROWS = 30, 21


def recorded(rows: int = ROWS, episodes: int = EPISODES) -> Dataset:
    """Random walks of the square; the state is where it is."""
    rng = np.random.default_rng(0)
    pixels = np.zeros((episodes * rows, 64, 64, 3), np.uint8)
    action = rng.uniform(-1, 1, (episodes * rows, 2)).astype(np.float32)
    state = np.zeros((episodes * rows, 2), np.float32)
    for row in range(len(pixels)):
        new = row % rows == 0
        before = rng.uniform(10, 54, 2) if new else state[row - 1] + 6 * action[row - 1]
        state[row] = np.clip(before, 8, 56)
        x, y = state[row].astype(int)
        pixels[row, y - 8 : y + 8, x - 8 : x + 8] = (255, 120, 30)
    action[rows - 1 :: rows] = np.nan
    length = np.full(episodes, rows, np.int32)
    return Dataset(pixels, action, state, length, np.arange(episodes) * rows, None)


def setting(work: Path, seed: int = 0) -> Setting:
    """A training in a folder of its own."""
    work.mkdir(exist_ok=True)
    return Setting(seed, work, torch.device("cpu"), Silent())
