"""Datasets of episodes: one file each while they are collected, one file for all after that.

A shard is a dataset of one episode; both have the layout of `dataset_file`.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from elast_cli import dataset_file, seeding
from elast_cli.dataset_file import column_digests
from elast_cli.errors import DataError
from elast_cli.publish import sync_folder

__all__ = [
    "Dataset",
    "Episode",
    "column_digests",
    "compact",
    "read_shard",
    "shard_path",
    "stack_rows",
    "write_shard",
]


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
    """Episodes 0 .. E-1 end to end in memory, N rows in all.

    pixels     u8  [N, 64, 64, 3]
    action     f32 [N, A]  NaN in each episode's last row
    state      f32 [N, S]
    ep_len     i32 [E]     rows of each episode, at least 2
    ep_offset  i64 [E]     its first row
    context    u8  [E, H, W, 3] or None
    """

    pixels: NDArray[np.uint8]
    action: NDArray[np.float32]
    state: NDArray[np.float32]
    ep_len: NDArray[np.int32]
    ep_offset: NDArray[np.int64]
    context: NDArray[np.uint8] | None

    @classmethod
    def load(cls, path: Path) -> Dataset:
        """The dataset in a file, which may come from anyone.

        Raises:
            DataError: the file is unsafe, damaged or inconsistent; names the episode if it can.
        """
        contents = dataset_file.read(path)
        if contents.first_episode != 0:
            raise DataError(f"{path}: begins with episode {contents.first_episode}, not 0")
        data = contents.arrays
        return cls(
            pixels=data["pixels"],
            action=data["action"],
            state=data["state"],
            ep_len=data["ep_len"],
            ep_offset=data["ep_offset"],
            context=data.get("context"),
        )

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


def stack_rows(
    rows: NDArray[np.int64], first: NDArray[np.int64], *, frames: int = 3
) -> NDArray[np.int64]:
    """Rows of the frames that make up each state, oldest first: [..., frames].

    `first` is the first row of each row's episode; before it the first frame is repeated, as if the
    world had been at rest.
    """
    stacked: NDArray[np.int64] = rows[..., None] + np.arange(1 - frames, 1)  # [..., frames]
    return np.maximum(stacked, first[..., None], dtype=np.int64)


def shard_path(folder: Path, index: int) -> Path:
    """Where episode `index` of a collection goes."""
    return folder / f"episode-{index:07d}.h5"


def write_shard(path: Path, episode: Episode) -> None:
    """Put one episode on disk, whole or not at all."""
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with dataset_file.create_columns(
            temporary,
            [len(episode.pixels)],
            _row_shapes(episode),
            first_episode=episode.seed_index,
        ) as columns:
            _fill(columns, episode, 0)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def read_shard(path: Path) -> Episode:
    """The episode in a shard. Raises DataError if it is damaged."""
    contents = dataset_file.read(path)
    data = contents.arrays
    if len(data["ep_len"]) != 1:
        raise DataError(f"{path}: a shard holds one episode, not {len(data['ep_len'])}")
    context = data["context"][0] if "context" in data else None
    return Episode(data["pixels"], data["action"], data["state"], context, contents.first_episode)


def compact(
    shards: Sequence[Path], out: Path, *, attrs: dataset_file.Attributes | None = None
) -> None:
    """Write shards 0 .. E-1 end to end into the new file `out`, byte for byte reproducibly.

    Raises:
        DataError: a shard is damaged, of another shape, or not the one its place asks for.
    """
    lengths = [dataset_file.count_rows(path) for path in shards]
    shapes = _row_shapes(read_shard(shards[0]))
    with dataset_file.create_columns(out, lengths, shapes, attrs=attrs) as columns:
        offset = 0
        for place, path in enumerate(shards):
            episode = read_shard(path)
            if episode.seed_index != place:
                raise DataError(f"{path}: holds episode {episode.seed_index}, not {place}")
            if _row_shapes(episode) != shapes:
                raise DataError(f"{path}: episode {place} has rows of another shape than episode 0")
            _fill(columns, episode, offset)
            offset += lengths[place]


def _row_shapes(episode: Episode) -> dict[str, tuple[int, ...]]:
    """Shape of one row of each column that an episode fills."""
    shapes = {name: getattr(episode, name).shape[1:] for name in ("action", "state", "pixels")}
    return shapes if episode.context is None else {**shapes, "context": episode.context.shape}


def _fill(columns: Mapping[str, h5py.Dataset], episode: Episode, offset: int) -> None:
    """Write the episode's rows from row `offset` on; its one context image stands for all rows."""
    for name, column in columns.items():
        column[offset : offset + len(episode.pixels)] = getattr(episode, name)
