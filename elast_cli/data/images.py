"""Images that are read on access, so that a dataset may be larger than memory."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import h5py
import numpy as np

from elast_cli.data.checks import Rows
from elast_cli.data.chunks import CHUNK_ROWS, read_chunk
from elast_cli.data.safety import Column, open_columns
from elast_cli.errors import DataError
from elast_cli.shapes import Int64, Uint8

BLOCK = 16 * CHUNK_ROWS  # images read at once: 13 MB


class Images(Protocol):
    """Images u8 [N,H,W,3] by row: a numpy array, or a column of a file."""

    @property
    def shape(self) -> tuple[int, ...]:
        """N, H, W, 3."""
        ...

    def __len__(self) -> int:
        """N."""
        ...

    def __getitem__(self, rows: slice | Int64, /) -> Uint8:
        """The images at some rows [M]: u8 [M,H,W,3]."""
        ...


def blocks(images: Images) -> Iterator[tuple[Int64, Uint8]]:
    """All images in order, `BLOCK` at a time, each block with its rows."""
    for start in range(0, len(images), BLOCK):
        block = images[start : start + BLOCK]
        yield np.arange(start, start + len(block)), block


class OpenFile:
    """The columns of an HDF5 file that stays open as long as anything refers to this."""

    def __init__(self, path: Path, columns: Mapping[str, Column]) -> None:
        """Open an untrusted file.

        Raises:
            DataError: it is damaged, or holds anything else than these columns.
        """
        stack = ExitStack()
        self.columns = stack.enter_context(open_columns(path, columns))
        self._close = weakref.finalize(self, stack.close)

    def close(self) -> None:
        """Close it now."""
        self._close()


class StoredImages:
    """A column of images of an open file; the checksum of a chunk is verified when it is read."""

    def __init__(self, file: OpenFile, name: str, rows: Rows, at: Int64 | None = None) -> None:
        """Take all rows of the column `name`, or those `at` [E].

        Args:
            file: holds the column, and stays open as long as this does.
            name: of a column u8 [N,H,W,3].
            rows: where the episodes lie.
            at: i64 [E], rows of the column; then item i is the image at row at[i].

        Raises:
            DataError: the column has another number of rows than the episodes.
        """
        rows.check_length(file.columns, name)
        self._file, self._name, self._rows, self._at = file, name, rows, at
        self._column: h5py.Dataset = file.columns[name]
        self._piece = self._column.chunks[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """N, H, W, 3."""
        return len(self), *self._column.shape[1:]

    def __len__(self) -> int:
        """N."""
        return len(self._column) if self._at is None else len(self._at)

    def __getitem__(self, rows: slice | Int64, /) -> Uint8:
        """The images at some rows [M]: u8 [M,H,W,3]; each chunk is read once.

        Raises:
            DataError: a chunk is damaged, which names its episodes, or there is no such row.
        """
        if isinstance(rows, slice):
            rows = np.arange(*rows.indices(len(self)))
        wrong = (rows < 0) | (rows >= len(self))
        if wrong.any():
            row = int(rows[wrong.argmax()])
            raise DataError(f"{self._rows.path}: {self._name} has no row {row}, only {len(self)}")
        where = rows if self._at is None else self._at[rows]
        found = np.empty((len(where), *self._column.shape[1:]), np.uint8)
        order = np.argsort(where, kind="stable")
        piece = where[order] // self._piece
        edges = [0, *(np.flatnonzero(np.diff(piece)) + 1).tolist(), len(where)]
        for begin, end in itertools.pairwise(edges if len(where) else []):
            first = int(piece[begin]) * self._piece
            found[order[begin:end]] = self._read(first)[where[order[begin:end]] - first]
        return found

    def _read(self, first: int) -> Uint8:
        """The piece that begins at a row."""
        stop = min(first + self._piece, len(self._column))
        with self._rows.naming(self._name, first, stop):
            piece: Uint8 = read_chunk(self._column, first)
        return piece
