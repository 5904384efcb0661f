"""Chunks of columns: compressed as they come, copied as stored, checked as they are read."""

from __future__ import annotations

import math
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from elast_cli.errors import DataError

CHUNK_ROWS = 64  # frames in a chunk of images


class ImageChunks:
    """A column of images, compressed as they come, chunk by chunk.

    zlib-ng takes a third of the time of HDF5's own zlib, and every reader of gzip can read it. Its
    files are always the same; those of ISA-L, which is faster still, are not.
    """

    def __init__(self, row_shape: tuple[int, ...], *, lead: int = 0) -> None:
        """An empty column of images u8 [H, W, 3], after `lead` < CHUNK_ROWS blank rows."""
        self._row_shape = row_shape
        self._rows = 0
        self._chunks: list[bytes] = []
        self._begin_chunk()
        self._append_blank(lead)

    def append(self, images: NDArray[np.uint8]) -> None:
        """Put images u8 [n, H, W, 3] behind those that are there. Raises DataError for others."""
        if images.shape[1:] != self._row_shape or images.dtype != np.uint8:
            found = f"{images.dtype} {images.shape[1:]}"
            raise DataError(f"images of {found} behind some of uint8 {self._row_shape}")
        while len(images):
            fitting, images = np.split(images, [CHUNK_ROWS - self._rows % CHUNK_ROWS])
            # a compressor takes contiguous parts only; an image that stands for all rows is one
            parts = fitting if fitting.strides[0] == 0 else [fitting]
            self._parts += [self._compress(np.ascontiguousarray(part)) for part in parts]
            self._rows += len(fitting)
            if self._rows % CHUNK_ROWS == 0:
                self._end_chunk()

    def write(self, column: h5py.Dataset) -> None:
        """Put all of them, the lead among them, into a new column of as many rows; once.

        Raises:
            DataError: the column has another number of rows.
        """
        if self._rows != len(column):
            raise DataError(f"{self._rows} images for a column of {len(column)} rows")
        if self._rows < CHUNK_ROWS:  # a chunk is not longer than its column
            self._end_chunk()
        else:
            self._append_blank(-self._rows % CHUNK_ROWS)
        for place, chunk in enumerate(self._chunks):
            column.id.write_direct_chunk((place * CHUNK_ROWS, 0, 0, 0), chunk)

    def _append_blank(self, rows: int) -> None:
        self.append(np.zeros((rows, *self._row_shape), np.uint8))

    def _begin_chunk(self) -> None:
        compressor = zlib_ng.compressobj(level=2)
        self._compress, self._flush = compressor.compress, compressor.flush
        self._parts: list[bytes] = []

    def _end_chunk(self) -> None:
        """Keep the chunk as the file will hold it: compressed, then its checksum."""
        compressed = b"".join([*self._parts, self._flush()])
        self._chunks.append(compressed + _fletcher32(compressed).to_bytes(4, "little"))
        self._begin_chunk()


def storage(column: h5py.Dataset) -> tuple[object, ...]:
    """What two columns must have in common for a stored chunk of one to be one of the other."""
    return column.chunks, column.compression, column.shuffle, column.fletcher32


def read_chunk(column: h5py.Dataset, start: int) -> NDArray[Any]:
    """The values of the chunk that begins at row `start`, to its end or the column's.

    The bytes come from HDF5 as they are stored; its filters would trust them. So a chunk is exactly
    as long as its values, whatever it claims, and never takes more memory.

    Raises:
        OSError: wrong checksum, not deflated, or of another length.
    """
    values: NDArray[Any] = _values(column, *_stored(column, start))
    return values[: len(column) - start]


def _stored(column: h5py.Dataset, start: int) -> tuple[int, bytes]:
    """Which filters a chunk left out, as bits, and its bytes as they are stored."""
    found: tuple[int, bytes] = column.id.read_direct_chunk((start, *[0] * (column.ndim - 1)))
    return found


def _values(column: h5py.Dataset, skipped: int, stored: bytes) -> NDArray[Any]:
    """The values in a stored chunk. Raises OSError as `read_chunk` does."""
    size = math.prod(column.chunks) * column.dtype.itemsize
    if len(stored) < 4 or _fletcher32(stored[:-4]) != int.from_bytes(stored[-4:], "little"):
        raise OSError("wrong checksum")
    content: bytes = stored[:-4]
    if column.compression and not skipped & 1:  # what gzip would lengthen is stored as it is
        inflate = zlib_ng.decompressobj()
        try:
            content = inflate.decompress(content, size + 1)
        except zlib_ng.error as reason:  # type: ignore[misc]  # its stubs call it an object
            raise OSError(f"not deflated: {reason}") from None
    if len(content) != size:
        raise OSError(f"a chunk of {len(content)} bytes where {size} belong")
    return np.frombuffer(content, column.dtype).reshape(column.chunks)


def read_rows(column: h5py.Dataset, start: int, stop: int) -> NDArray[Any]:
    """The values of some rows, chunk by chunk. Raises OSError as `read_chunk` does.

    Args:
        column: of any type; its first axis is that of rows.
        start: the first row.
        stop: one past the last.
    """
    size = column.chunks[0]
    first = start // size * size
    pieces = [read_chunk(column, at) for at in range(first, stop, size)]
    return np.concatenate(pieces)[start - first : stop - first]


def read_whole(column: h5py.Dataset) -> NDArray[Any]:
    """All values of a column. Raises OSError as `read_chunk` does."""
    return read_rows(column, 0, len(column))


def copy_chunk(source: h5py.Dataset, start: int, target: h5py.Dataset, place: int) -> None:
    """Copy the stored chunk of images at row `start` to row `place`. Raises OSError if damaged.

    Args:
        source: a column u8 [N,H,W,3].
        start: the chunk's first row in it.
        target: a column with the same `storage`.
        place: the chunk's first row there.
    """
    skipped, stored = _stored(source, start)
    _values(source, skipped, stored)
    target.id.write_direct_chunk((place, 0, 0, 0), stored, skipped)


def _fletcher32(content: bytes) -> int:
    """The checksum that HDF5 appends to a chunk, of its 16-bit big-endian words."""
    words = np.frombuffer(content + b"\0" * (len(content) % 2), ">u2").astype(np.int64)
    sums = int(words.sum()), int(words @ np.arange(len(words), 0, -1))
    low, high = ((total - 1) % 65535 + 1 if total else 0 for total in sums)
    return high << 16 | low
