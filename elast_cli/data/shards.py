"""Shards: datasets of a few episodes, which `compact` joins into one file."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elast_cli.data import layout
from elast_cli.data.chunks import CHUNK_ROWS, ImageChunks
from elast_cli.data.dataset import Episode
from elast_cli.errors import DataError
from elast_cli.files import sync_folder


def shard_path(folder: Path, first: int) -> Path:
    """Where the shard of a collection goes whose first episode is `first`."""
    return folder / f"episodes-{first:07d}.h5"


def write_shard(path: Path, episodes: Iterable[Episode], *, first_row: int = 0) -> None:
    """Write consecutive episodes, whole or not at all. One episode is in memory at a time.

    `first_row` is the row of their first one in the dataset; images are then cut into chunks as
    they are there, and `compact` need not compress them again.

    Args:
        path: of the new file; one that is there is replaced.
        episodes: with numbers that follow each other.
        first_row: at least 0.

    Raises:
        DataError: there are no episodes, or their rows have different shapes.
    """
    packed = _Packed(lead=first_row % CHUNK_ROWS)
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
        self._images: dict[str, ImageChunks] = {}

    def append(self, episode: Episode) -> None:
        """Put an episode behind those that are there. Raises DataError if its rows are others."""
        rows, shapes = len(episode.pixels), _row_shapes(episode)
        if self._shapes and shapes != self._shapes:
            raise DataError(f"episode {episode.seed_index} has rows {shapes}, not {self._shapes}")
        if not self._shapes:
            self._shapes = shapes
            self._images = {
                name: ImageChunks(shape, lead=self._lead)
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
        with layout.create_columns(
            path, self._lengths, self._shapes, first_episode=self._numbers[0], lead=self._lead
        ) as out:
            for name, parts in self._vectors.items():
                out.columns[name][...] = np.concatenate(parts)
            for name, chunks in self._images.items():
                chunks.write(out.columns[name])


def compact(shards: Sequence[Path], out: Path, *, attrs: layout.Attributes | None = None) -> None:
    """Write shards end to end into the new file `out`, byte for byte reproducibly.

    Args:
        shards: in order; the first begins with episode 0.
        out: must not exist.
        attrs: of the new file.

    Raises:
        DataError: a shard is damaged, of another shape, or not the one its place asks for.
    """
    heads = [layout.read_head(path) for path in shards]
    lengths: list[int] = []
    for path, head in zip(shards, heads, strict=True):
        if head.first_episode != len(lengths):
            raise DataError(f"{path}: begins with episode {head.first_episode}, not {len(lengths)}")
        if head.row_shapes != heads[0].row_shapes:
            raise DataError(
                f"{path}: episode {len(lengths)} has rows of another shape than episode 0"
            )
        lengths += head.lengths
    with layout.create_columns(out, lengths, heads[0].row_shapes, attrs=attrs) as new:
        first_row = 0
        for path, head in zip(shards, heads, strict=True):
            layout.append(path, new, first_row)
            first_row += sum(head.lengths)


def _row_shapes(episode: Episode) -> dict[str, tuple[int, ...]]:
    """Shape of one row of each column that an episode fills; its context stands for all rows."""
    shapes = {name: getattr(episode, name).shape[1:] for name in ("action", "state", "pixels")}
    return shapes if episode.context is None else {**shapes, "context": episode.context.shape}
