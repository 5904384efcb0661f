"""The HDF5 layout of a dataset: flat columns, written reproducibly and read with suspicion.

    pixels (N,64,64,3) u8   action (N,A) f32   state (N,S) f32   context (N,H,W,3) u8, optional
    step_idx (N,) i32       ep_idx (N,) i32    ep_len (E,) i32   ep_offset (E,) i64

An episode of T steps has T + 1 rows. Row t holds what was seen at time t and the action taken
there; the last row's action is NaN. Every column but the last two has one value a row, because
readers of this layout cut all columns alike.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from elast_cli.data.checks import Rows
from elast_cli.data.chunks import CHUNK_ROWS, read_rows
from elast_cli.data.images import OpenFile, StoredImages
from elast_cli.data.newfile import NewFile
from elast_cli.data.safety import Column, open_columns

FRAME = (64, 64, 3)
NUMBER_CHUNK_ROWS = 4096
_U8, _F32, _I32, _I64 = (np.dtype(kind) for kind in ("u1", "<f4", "<i4", "<i8"))
COLUMNS: Mapping[str, Column] = {
    "ep_len": Column(_I32),
    "ep_offset": Column(_I64),
    "ep_idx": Column(_I32),
    "step_idx": Column(_I32),
    "action": Column(_F32, (None,)),
    "state": Column(_F32, (None,)),
    "pixels": Column(_U8, FRAME, lazy=True),
    "context": Column(_U8, (None, None, 3), required=False, lazy=True),
}
Attributes = Mapping[str, str | int | float]


@dataclass(frozen=True)
class NewColumns:
    """Columns of a new file, to be filled; call `check` after each few megabytes."""

    columns: Mapping[str, h5py.Dataset]
    file: NewFile

    def check(self) -> None:
        """Raise OSError if the disk has failed."""
        self.file.check()


@contextmanager
def create_columns(
    path: Path,
    lengths: Sequence[int],
    row_shapes: Mapping[str, tuple[int, ...]],
    *,
    first_episode: int = 0,
    lead: int = 0,
    attrs: Attributes | None = None,
) -> Iterator[NewColumns]:
    """The columns in `row_shapes` of a new file, to be filled; the index columns are full.

    The file goes to disk as it is filled, and is removed if that fails.

    Args:
        path: a name that does not exist yet.
        lengths: rows of each episode.
        row_shapes: column -> shape of one row.
        first_episode: number of the first episode.
        lead: blank rows before the first one, in columns of images; 0 in a dataset.
        attrs: attributes of the file.
    """
    disk = NewFile(path)
    try:
        with h5py.File(disk, "w", libver=("v110", "v110")) as file:
            file.attrs.update(attrs or {})
            for name, values in _index(lengths, first_episode).items():
                _create(file, name, values.shape)[...] = values
            rows = sum(lengths)
            columns = {
                name: _create(file, name, (rows + (lead if _of_images(shape) else 0), *shape))
                for name, shape in row_shapes.items()
            }
            yield NewColumns(columns, disk)
        disk.finish()
    except BaseException:
        disk.remove()
        raise


def _index(lengths: Sequence[int], first_episode: int) -> dict[str, NDArray[Any]]:
    """The index columns of episodes of these lengths."""
    length = np.array(lengths, _I32)
    rows, number = int(length.sum()), np.arange(first_episode, first_episode + len(length))
    offset = np.cumsum(length, dtype=_I64) - length
    return {
        "ep_len": length,
        "ep_offset": offset,
        "ep_idx": np.repeat(number, length),
        "step_idx": np.arange(rows) - np.repeat(offset, length),
    }


def _create(file: h5py.File, name: str, shape: tuple[int, ...]) -> h5py.Dataset:
    """A new checksummed column; without times, so that equal data make equal files."""
    image = _of_images(shape[1:])
    rows = min(shape[0], CHUNK_ROWS if image else NUMBER_CHUNK_ROWS)
    return file.create_dataset(
        name,
        shape,
        COLUMNS[name].dtype,
        chunks=(rows, *shape[1:]),
        compression="gzip" if image else None,
        compression_opts=1 if image else None,
        fletcher32=True,
        track_times=False,
    )


def _of_images(row_shape: tuple[int, ...]) -> bool:
    return len(row_shape) == 3


@dataclass(frozen=True)
class Contents:
    """Checked content of a file; images are read on access.

    first_episode  number of its first episode
    numbers        action, state, ep_len and ep_offset, as in `Dataset`
    pixels         of each row
    context        of each episode, or None
    """

    first_episode: int
    numbers: dict[str, NDArray[Any]]
    pixels: StoredImages
    context: StoredImages | None


def read(path: Path) -> Contents:
    """Everything in an untrusted file.

    Raises:
        DataError: the file is unsafe, damaged or inconsistent; names the episode if it can.
    """
    file = OpenFile(path, COLUMNS)
    rows, numbers = _read_numbers(path, file.columns)
    return Contents(
        rows.first_episode,
        numbers,
        pixels=StoredImages(file, "pixels", rows),
        context=StoredImages(file, "context", rows, at=rows.offset)
        if "context" in file.columns
        else None,
    )


@dataclass(frozen=True)
class Head:
    """What a file holds: its first episode, rows of each, and shape of a row by column."""

    first_episode: int
    lengths: list[int]
    row_shapes: dict[str, tuple[int, ...]]


def read_head(path: Path) -> Head:
    """What a file says that it holds. Raises DataError if it is unsafe to open, or damaged."""
    with open_columns(path, COLUMNS) as columns:
        rows = Rows.of(path, columns)
        shapes = {name: column.shape[1:] for name, column in columns.items() if column.ndim > 1}
        return Head(rows.first_episode, rows.length.tolist(), shapes)


def append(path: Path, out: NewColumns, first: int) -> None:
    """Copy a file's rows to the rows of `out` from `first` on; its images may have a lead.

    Chunks of images that are the same in both are copied as they are stored, compressed.

    Args:
        path: of an untrusted file.
        out: columns of the new file.
        first: row of `out` for the file's first row.

    Raises:
        DataError: the file is unsafe, damaged or inconsistent; names the episode if it can.
        OSError: the disk has failed.
    """
    with open_columns(path, COLUMNS) as columns:
        rows, numbers = _read_numbers(path, columns)
        for name, target in out.columns.items():
            if name in numbers:
                target[first : first + rows.count] = numbers[name]
            else:
                rows.copy(columns, name, target, first)
    out.check()


def _read_numbers(
    path: Path, columns: Mapping[str, h5py.Dataset]
) -> tuple[Rows, dict[str, NDArray[Any]]]:
    """Where the episodes lie, and every column but those of images, found consistent."""
    rows = Rows.of(path, columns)
    rows.check_counters(columns)
    action, state = rows.read(columns, "action"), rows.read(columns, "state")
    rows.check_numbers(action, state)
    numbers: dict[str, NDArray[Any]] = {"ep_len": rows.length, "ep_offset": rows.offset}
    return rows, {**numbers, "action": action, "state": state}


def column_digests(path: Path) -> dict[str, str]:
    """SHA-256 of each column's type, shape and values."""
    digests = {}
    with open_columns(path, COLUMNS) as columns:
        for name, column in columns.items():
            digest = hashlib.sha256(f"{column.dtype.str} {column.shape}".encode())
            for start in range(0, len(column), CHUNK_ROWS):
                digest.update(
                    read_rows(column, start, min(start + CHUNK_ROWS, len(column))).tobytes()
                )
            digests[name] = digest.hexdigest()
    return digests
