"""The HDF5 layout of a dataset: flat columns, written reproducibly and read with suspicion.

    pixels (N,64,64,3) u8   action (N,A) f32   state (N,S) f32   context (N,H,W,3) u8, optional
    step_idx (N,) i32       ep_idx (N,) i32    ep_len (E,) i32   ep_offset (E,) i64

An episode of T steps has T + 1 rows. Row t holds what was seen at time t and the action taken
there; the last row's action is NaN. Every column but the last two has one value a row, because
readers of this layout cut all columns alike.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from elast_cli.data.chunks import CHUNK_ROWS, copy_chunk, storage
from elast_cli.data.safety import HDF5_ERRORS, Column, open_columns
from elast_cli.errors import DataError

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
    "pixels": Column(_U8, FRAME),
    "context": Column(_U8, (None, None, 3), required=False),
}
Attributes = Mapping[str, str | int | float]


@contextmanager
def create_columns(
    path: Path,
    lengths: Sequence[int],
    row_shapes: Mapping[str, tuple[int, ...]],
    *,
    first_episode: int = 0,
    lead: int = 0,
    attrs: Attributes | None = None,
) -> Iterator[dict[str, h5py.Dataset]]:
    """The columns in `row_shapes` of a new file, to be filled; the index columns are full.

    The file is built in memory and put on disk at the end: HDF5 itself crashes on a full disk.

    Args:
        path: a name that does not exist yet.
        lengths: rows of each episode.
        row_shapes: column -> shape of one row.
        first_episode: number of the first episode.
        lead: blank rows before the first one, in columns of images; 0 in a dataset.
        attrs: attributes of the file.
    """
    length = np.array(lengths, _I32)
    rows, number = int(length.sum()), np.arange(first_episode, first_episode + len(length))
    offset = np.cumsum(length, dtype=_I64) - length
    index = {
        "ep_len": length,
        "ep_offset": offset,
        "ep_idx": np.repeat(number, length),
        "step_idx": np.arange(rows) - np.repeat(offset, length),
    }
    content = io.BytesIO()
    with h5py.File(content, "w", libver=("v110", "v110")) as file:
        file.attrs.update(attrs or {})
        for name, values in index.items():
            _create(file, name, values.shape)[...] = values
        yield {
            name: _create(file, name, (rows + (lead if _of_images(shape) else 0), *shape))
            for name, shape in row_shapes.items()
        }
    with open(path, "xb") as disk:
        disk.write(content.getbuffer())
        disk.flush()
        os.fsync(disk.fileno())


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
    """All that a file holds, found consistent; arrays as in `Dataset`."""

    first_episode: int
    arrays: dict[str, NDArray[Any]]  # pixels, action, state, ep_len, ep_offset, maybe context


def read(path: Path) -> Contents:
    """Everything in a file, which may come from anyone.

    Raises:
        DataError: the file is unsafe, damaged or inconsistent; names the episode if it can.
    """
    with open_columns(path, COLUMNS) as columns:
        rows, arrays = _read_numbers(path, columns)
        arrays["pixels"] = rows.read(columns, "pixels")
        if "context" in columns:
            arrays["context"] = rows.read_firsts(columns, "context")
        return Contents(rows.first_episode, arrays)


@dataclass(frozen=True)
class Head:
    """What a file holds: its first episode, rows of each, and shape of a row by column."""

    first_episode: int
    lengths: list[int]
    row_shapes: dict[str, tuple[int, ...]]


def read_head(path: Path) -> Head:
    """What a file says that it holds. Raises DataError if it is unsafe to open, or damaged."""
    with open_columns(path, COLUMNS) as columns:
        length = columns["ep_len"][:]
        _check_episodes(path, length, columns["ep_offset"][:], len(columns["ep_idx"]))
        shapes = {name: column.shape[1:] for name, column in columns.items() if column.ndim > 1}
        return Head(int(columns["ep_idx"][0]), length.tolist(), shapes)


def append(path: Path, out: Mapping[str, h5py.Dataset], first: int) -> None:
    """Copy a file's rows to the rows of `out` from `first` on; its images may have a lead.

    Chunks of images that are the same in both are copied as they are stored, compressed.

    Raises:
        DataError: the file is unsafe, damaged or inconsistent; names the episode if it can.
    """
    with open_columns(path, COLUMNS) as columns:
        rows, arrays = _read_numbers(path, columns)
        for name, target in out.items():
            if name in arrays:
                target[first : first + rows.count] = arrays[name]
            else:
                rows.copy(columns, name, target, first)


def _read_numbers(
    path: Path, columns: Mapping[str, h5py.Dataset]
) -> tuple[_Rows, dict[str, NDArray[Any]]]:
    """Where the episodes lie, and every column but those of images, found consistent."""
    length, offset = columns["ep_len"][:], columns["ep_offset"][:]
    _check_episodes(path, length, offset, len(columns["ep_idx"]))
    rows = _Rows(path, length, offset, int(columns["ep_idx"][0]))
    rows.check_counters(columns)
    action, state = rows.read(columns, "action"), rows.read(columns, "state")
    rows.check_numbers(action, state)
    return rows, {"ep_len": length, "ep_offset": offset, "action": action, "state": state}


def column_digests(path: Path) -> dict[str, str]:
    """SHA-256 of each column's type, shape and values."""
    digests = {}
    with open_columns(path, COLUMNS) as columns:
        for name, column in columns.items():
            digest = hashlib.sha256(f"{column.dtype.str} {column.shape}".encode())
            for start in range(0, len(column), CHUNK_ROWS):
                digest.update(column[start : start + CHUNK_ROWS].tobytes())
            digests[name] = digest.hexdigest()
    return digests


def _check_episodes(
    path: Path, length: NDArray[np.int32], offset: NDArray[np.int64], rows: int
) -> None:
    """Raise DataError unless the episodes lie end to end and fill all rows."""
    if len(length) != len(offset):
        raise DataError(f"{path}: ep_len has {len(length)} rows, ep_offset {len(offset)}")
    end = np.cumsum(length, dtype=np.int64)
    for fault, wrong in {
        "has fewer than 2 rows": length < 2,
        "does not begin where the one before it ends": offset != end - length,
        "ends after the last row": end > rows,
    }.items():
        if wrong.any():
            raise DataError(f"{path}: episode {int(wrong.argmax())} {fault}")
    if end[-1] != rows:
        raise DataError(f"{path}: episode {len(length) - 1} ends at row {end[-1]} of {rows}")


@dataclass(frozen=True)
class _Rows:
    """Where each episode lies, to read its columns and to name it when they are wrong."""

    path: Path
    length: NDArray[np.int32]
    offset: NDArray[np.int64]
    first_episode: int

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.length.sum())

    def read(self, columns: Mapping[str, h5py.Dataset], name: str) -> NDArray[Any]:
        """A column of one value a row, chunk by chunk."""
        self._check_length(columns, name)
        column = columns[name]
        values = np.empty(column.shape, column.dtype)
        for start in range(0, len(column), column.chunks[0]):
            stop = min(start + column.chunks[0], len(column))
            with self._naming(name, start, stop):
                values[start:stop] = column[start:stop]
        return values

    def copy(
        self, columns: Mapping[str, h5py.Dataset], name: str, target: h5py.Dataset, first: int
    ) -> None:
        """Copy a column of images to the rows of `target` from `first` on, chunk by chunk."""
        source, size = columns[name], target.chunks[0]
        lead = len(source) - self.count
        self._check_lead(name, lead, most=CHUNK_ROWS - 1)
        shift = first - lead  # row r of the source is row r + shift of the target
        aligned = shift % size == 0 and storage(source) == storage(target)
        edges = {lead, len(source), *range(-shift % size, len(source), size)}
        for start, stop in itertools.pairwise(sorted(edge for edge in edges if edge >= lead)):
            with self._naming(name, start - lead, stop - lead):
                whole = stop - start == size or stop + shift == len(target)
                if aligned and whole and start % size == 0:
                    copy_chunk(source, start, target, start + shift)
                else:
                    target[start + shift : stop + shift] = source[start:stop]

    def read_firsts(self, columns: Mapping[str, h5py.Dataset], name: str) -> NDArray[Any]:
        """The first row of every episode, of a column that is constant in each."""
        self._check_length(columns, name)
        return np.stack([columns[name][row] for row in self.offset])

    def check_counters(self, columns: Mapping[str, h5py.Dataset]) -> None:
        """Raise DataError unless ep_idx and step_idx count episodes and steps."""
        episode = np.repeat(np.arange(len(self.length)), self.length)
        expected = {
            "ep_idx": episode + self.first_episode,
            "step_idx": np.arange(len(episode)) - self.offset[episode],
        }
        for name, values in expected.items():
            self._refuse(
                np.not_equal(self.read(columns, name), values), f"{name} does not count up"
            )

    def check_numbers(self, action: NDArray[np.float32], state: NDArray[np.float32]) -> None:
        """Raise DataError unless exactly each episode's last action is NaN, and states finite."""
        last = np.zeros(len(action), bool)
        last[self.offset + self.length - 1] = True
        some_wild = np.any(~np.isfinite(action), axis=1)
        some_given = np.any(~np.isnan(action), axis=1)
        self._refuse(some_wild & ~last, "an action before the last one is not finite")
        self._refuse(some_given & last, "the last row's action is not NaN")
        self._refuse(np.any(~np.isfinite(state), axis=1), "a state is not finite")

    @contextmanager
    def _naming(self, name: str, start: int, stop: int) -> Iterator[None]:
        """Turn what h5py raises for damaged data into a DataError that names column and rows."""
        try:
            yield
        except HDF5_ERRORS:
            span = f"{self._place(start)} to {self._place(stop - 1)}"
            raise DataError(f"{self.path}: {name} is damaged in {span}") from None

    def _place(self, row: int) -> str:
        """The episode and step that a row belongs to."""
        episode = int(np.searchsorted(self.offset, row, side="right")) - 1
        return f"episode {episode + self.first_episode} step {row - self.offset[episode]}"

    def _check_length(self, columns: Mapping[str, h5py.Dataset], name: str) -> None:
        self._check_lead(name, len(columns[name]) - self.count, most=0)

    def _check_lead(self, name: str, lead: int, *, most: int) -> None:
        if not 0 <= lead <= most:
            rows = self.count + lead
            raise DataError(f"{self.path}: {name} has {rows} rows, the episodes {self.count}")

    def _refuse(self, wrong: NDArray[Any], fault: str) -> None:
        if wrong.any():
            raise DataError(f"{self.path}: {self._place(int(wrong.argmax()))}: {fault}")
