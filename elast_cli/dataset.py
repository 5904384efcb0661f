"""Datasets of episodes: one file a few while they are collected, one file for all after that.

A shard is a dataset of consecutive episodes; both have the layout of `dataset_file`.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

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


def shard_path(folder: Path, first: int) -> Path:
    """Where the shard of a collection goes whose first episode is `first`."""
    return folder / f"episodes-{first:07d}.h5"


def write_shard(path: Path, episodes: Iterable[Episode], *, first_row: int = 0) -> None:
    """Put consecutive episodes on disk, whole or not at all; none is kept once the next is asked.

    `first_row` is the row of their first one in the dataset; images are then cut into chunks as
    they are there, and `compact` need not compress them again.
    """
    packed = _Packed(lead=first_row % dataset_file.CHUNK_ROWS)
    for episode in episodes:
        packed.append(episode)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        packed.write(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


class _Packed:
    """Episodes end to end, their images compressed as they come."""

    def __init__(self, *, lead: int) -> None:
        """No episodes yet; columns of images begin with `lead` blank rows."""
        self._lead = lead
        self._numbers: list[int] = []
        self._lengths: list[int] = []
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._vectors: dict[str, list[NDArray[np.float32]]] = {"action": [], "state": []}
        self._images: dict[str, dataset_file.ImageChunks] = {}

    def append(self, episode: Episode) -> None:
        """Put an episode behind those that are there. Raises DataError if its rows are others."""
        rows, shapes = len(episode.pixels), _row_shapes(episode)
        if self._shapes and shapes != self._shapes:
            raise DataError(f"episode {episode.seed_index} has rows {shapes}, not {self._shapes}")
        if not self._shapes:
            self._shapes = shapes
            self._images = {
                name: dataset_file.ImageChunks(shape, lead=self._lead)
                for name, shape in self._shapes.items()
                if name not in self._vectors
            }
        self._numbers.append(episode.seed_index)
        self._lengths.append(rows)
        for name, parts in self._vectors.items():
            parts.append(getattr(episode, name))
        self._images["pixels"].append(episode.pixels)
        if episode.context is not None:  # stands for all rows
            repeated = np.broadcast_to(episode.context, (rows, *episode.context.shape))
            self._images["context"].append(repeated)

    def write(self, path: Path) -> None:
        """Put all of them into a new file. Raises DataError if there are none."""
        if not self._numbers:
            raise DataError(f"{path}: a dataset of no episodes")
        with dataset_file.create_columns(
            path, self._lengths, self._shapes, first_episode=self._numbers[0], lead=self._lead
        ) as columns:
            for name, parts in self._vectors.items():
                columns[name][...] = np.concatenate(parts)
            for name, chunks in self._images.items():
                chunks.write(columns[name])


def compact(
    shards: Sequence[Path], out: Path, *, attrs: dataset_file.Attributes | None = None
) -> None:
    """Write shards end to end into the new file `out`, byte for byte reproducibly.

    Raises:
        DataError: a shard is damaged, of another shape, or not the one its place asks for.
    """
    heads = [dataset_file.read_head(path) for path in shards]
    lengths: list[int] = []
    for path, head in zip(shards, heads, strict=True):
        if head.first_episode != len(lengths):
            raise DataError(f"{path}: begins with episode {head.first_episode}, not {len(lengths)}")
        if head.row_shapes != heads[0].row_shapes:
            raise DataError(
                f"{path}: episode {len(lengths)} has rows of another shape than episode 0"
            )
        lengths += head.lengths
    with dataset_file.create_columns(out, lengths, heads[0].row_shapes, attrs=attrs) as columns:
        first_row = 0
        for path, head in zip(shards, heads, strict=True):
            dataset_file.append(path, columns, first_row)
            first_row += sum(head.lengths)


def _row_shapes(episode: Episode) -> dict[str, tuple[int, ...]]:
    """Shape of one row of each column that an episode fills; its context stands for all rows."""
    shapes = {name: getattr(episode, name).shape[1:] for name in ("action", "state", "pixels")}
    return shapes if episode.context is None else {**shapes, "context": episode.context.shape}
