"""Small random episodes, and shards of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from elast_cli.data.dataset import Episode
from elast_cli.data.shards import shard_path, write_shard

STEPS = (5, 70, 1, 12)


def episode(index: int, steps: int, *, context: bool = False) -> Episode:
    rng = np.random.default_rng(index)
    action = rng.uniform(-1, 1, (steps + 1, 2)).astype(np.float32)
    action[-1] = np.nan
    return Episode(
        pixels=rng.integers(0, 256, (steps + 1, 64, 64, 3), np.uint8),
        action=action,
        state=rng.normal(size=(steps + 1, 3)).astype(np.float32),
        context=rng.integers(0, 256, (8, 8, 3), np.uint8) if context else None,
        seed_index=index,
    )


def write_all(folder: Path, episodes: list[Episode]) -> list[Path]:
    return write_cut(folder, [[one] for one in episodes])


def write_cut(folder: Path, parts: list[list[Episode]]) -> list[Path]:
    """One shard a part, cut into chunks as the dataset will be."""
    paths, row = [shard_path(folder, part[0].seed_index) for part in parts], 0
    for path, part in zip(paths, parts, strict=True):
        write_shard(path, part, first_row=row)
        row += sum(len(one.pixels) for one in part)
    return paths


def flat(index: int, steps: int) -> Episode:
    """An episode whose frames gzip can shorten."""
    frames = np.full((steps + 1, 64, 64, 3), index, np.uint8)
    frames[:, 5, 5, 0] = np.arange(steps + 1)
    return replace(episode(index, steps), pixels=frames)
