"""Places of the episodes in a file: to check its columns and to name damage."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from elast_cli.data.chunks import CHUNK_ROWS, copy_chunk, read_chunk, read_rows, read_whole, storage
from elast_cli.data.safety import HDF5_ERRORS
from elast_cli.errors import DataError


@dataclass(frozen=True)
class Rows:
    """Where each episode lies, to read its columns and to name it when they are wrong.

    path           the file
    length         i32 [E] rows of each episode
    offset         i64 [E] its first row
    first_episode  number of the first episode
    """

    path: Path
    length: NDArray[np.int32]
    offset: NDArray[np.int64]
    first_episode: int

    @classmethod
    def of(cls, path: Path, columns: Mapping[str, h5py.Dataset]) -> Rows:
        """Read from the index columns. Raises DataError unless episodes fill all rows."""
        try:
            length, offset = (read_whole(columns[name]) for name in ("ep_len", "ep_offset"))
            first = int(read_chunk(columns["ep_idx"], 0)[0])
        except HDF5_ERRORS as reason:
            raise DataError(f"{path}: ep_len, ep_offset or ep_idx is damaged: {reason}") from None
        _check_episodes(path, length, offset, len(columns["ep_idx"]))
        return cls(path, length, offset, first)

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.length.sum())

    def read(self, columns: Mapping[str, h5py.Dataset], name: str) -> NDArray[Any]:
        """A column of one value a row, chunk by chunk."""
        self.check_length(columns, name)
        column = columns[name]
        values = np.empty(column.shape, column.dtype)
        for start in range(0, len(column), column.chunks[0]):
            stop = min(start + column.chunks[0], len(column))
            with self.naming(name, start, stop):
                values[start:stop] = read_chunk(column, start)
        return values

    def copy(
        self, columns: Mapping[str, h5py.Dataset], name: str, target: h5py.Dataset, first: int
    ) -> None:
        """Copy a column of images to the rows of `target` from `first` on, chunk by chunk.

        Args:
            columns: of the file that is read.
            name: of the column; images u8 [N,H,W,3], perhaps after a lead of blank rows.
            target: a column u8 of the file that is written.
            first: row of `target`; the lead is not copied.

        Raises:
            DataError: the column has another number of rows than the episodes, or a chunk is
                damaged.
        """
        source, size = columns[name], target.chunks[0]
        lead = len(source) - self.count
        self._check_lead(name, lead, most=CHUNK_ROWS - 1)
        shift = first - lead  # row r of the source is row r + shift of the target
        aligned = shift % size == 0 and storage(source) == storage(target)
        edges = {lead, len(source), *range(-shift % size, len(source), size)}
        for start, stop in itertools.pairwise(sorted(edge for edge in edges if edge >= lead)):
            with self.naming(name, start - lead, stop - lead):
                whole = stop - start == size or stop + shift == len(target)
                if aligned and whole and start % size == 0:
                    copy_chunk(source, start, target, start + shift)
                else:
                    target[start + shift : stop + shift] = read_rows(source, start, stop)

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
        """Raise DataError unless each episode ends with NaN and all else is in range.

        Actions lie in [-1, 1], and states are finite.
        """
        last = np.zeros(len(action), bool)
        last[self.offset + self.length - 1] = True
        some_wild = np.any(~np.isfinite(action), axis=1)
        some_given = np.any(~np.isnan(action), axis=1)
        self._refuse(some_wild & ~last, "an action before the last one is not finite")
        self._refuse(some_given & last, "the last row's action is not NaN")
        self._refuse(np.any(np.abs(action) > 1, axis=1), "an action is outside [-1, 1]")
        self._refuse(np.any(~np.isfinite(state), axis=1), "a state is not finite")

    def check_length(self, columns: Mapping[str, h5py.Dataset], name: str) -> None:
        """Raise DataError unless a column has as many rows as the episodes."""
        self._check_lead(name, len(columns[name]) - self.count, most=0)

    @contextmanager
    def naming(self, name: str, start: int, stop: int) -> Iterator[None]:
        """Turn what h5py raises for damaged data into a DataError that names column and rows.

        Args:
            name: of the column.
            start: the first row that is read.
            stop: one past the last.
        """
        try:
            yield
        except HDF5_ERRORS:
            span = f"{self._place(start)} to {self._place(stop - 1)}"
            raise DataError(f"{self.path}: {name} is damaged in {span}") from None

    def _place(self, row: int) -> str:
        """The episode and step that a row belongs to."""
        episode = int(np.searchsorted(self.offset, row, side="right")) - 1
        return f"episode {episode + self.first_episode} step {row - self.offset[episode]}"

    def _check_lead(self, name: str, lead: int, *, most: int) -> None:
        if not 0 <= lead <= most:
            rows = self.count + lead
            raise DataError(f"{self.path}: {name} has {rows} rows, the episodes {self.count}")

    def _refuse(self, wrong: NDArray[Any], fault: str) -> None:
        if wrong.any():
            raise DataError(f"{self.path}: {self._place(int(wrong.argmax()))}: {fault}")


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
