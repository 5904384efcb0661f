"""Reading untrusted HDF5: no other path is opened, memory is bounded.

HDF5 can point to other files (external links, external storage, virtual datasets), promise far
more data than it holds, and run filter plug-ins. A dataset of elast needs none of this, so a file
must be flat, with known columns of known types, plain chunks and known filters; nothing is read
before that is established. The library is given an open handle instead of a path: it then has no
way to open another file, and cannot be made to wait on one (a virtual dataset over a FIFO would).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5l, h5o, h5z

from elast_cli.errors import DataError
from elast_cli.files import open_regular

MAX_BYTES = 16 << 30  # of what is read whole
MAX_LAZY_BYTES = 16 << 40
MAX_CHUNK_BYTES = 4 << 20
MAX_RATIO = 300  # declared bytes a stored byte; true frames reach 6 to 110
SPARE_BYTES = 64 << 20  # so much does no harm at any ratio

_PIPELINES = {(h5z.FILTER_FLETCHER32,), (h5z.FILTER_DEFLATE, h5z.FILTER_FLETCHER32)}
# what h5py raises for a damaged file, besides OSError
HDF5_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, EOFError, OverflowError)


@dataclass(frozen=True)
class Column:
    """What a column must be.

    dtype     of its values
    row       shape of a row (None: any size in 1..4096)
    required  whether every file has it
    lazy      whether it is read in pieces only, so that it may be larger than memory
    """

    dtype: np.dtype[np.generic]
    row: tuple[int | None, ...] = ()
    required: bool = True
    lazy: bool = False

    @property
    def most_bytes(self) -> int:
        """How large it may be."""
        return MAX_LAZY_BYTES if self.lazy else MAX_BYTES


@contextmanager
def open_columns(path: Path, columns: Mapping[str, Column]) -> Iterator[dict[str, h5py.Dataset]]:
    """The columns of a flat HDF5 file, each of them found safe to read in pieces.

    Raises:
        DataError: the file is damaged, or holds anything else than these columns.
    """
    try:
        with open_regular(path) as handle, h5py.File(handle, "r") as file:
            yield _checked(file, columns, path.stat().st_size)
    except HDF5_ERRORS as reason:
        text = " ".join(str(reason).split())[:300]
        raise DataError(f"{path}: not a readable dataset: {text}") from None


def _checked(
    file: h5py.File, columns: Mapping[str, Column], file_bytes: int
) -> dict[str, h5py.Dataset]:
    """All columns by name. Raises ValueError for the first thing that is not as it must be."""
    names = set()
    for raw in file.id:  # names only; opens nothing
        name = raw.decode("utf-8", "replace")
        if name not in columns:
            raise ValueError(f"unknown column {name[:60]!r}; known: {', '.join(columns)}")
        names.add(name)
    missing = [name for name, column in columns.items() if column.required and name not in names]
    if missing:
        raise ValueError(f"column {missing[0]!r} is missing")
    found = {}
    declared = stored = whole = 0
    for name in columns:
        if name in names:
            found[name] = _column(file, name, columns[name])
            declared += found[name].nbytes
            whole += 0 if columns[name].lazy else found[name].nbytes
            stored += found[name].id.get_storage_size()
    if stored > file_bytes:
        raise ValueError("its columns overlap")
    if whole > MAX_BYTES or declared > stored * MAX_RATIO + SPARE_BYTES:
        raise ValueError(f"it declares {declared} bytes and stores {stored}")
    return found


def _column(file: h5py.File, name: str, column: Column) -> h5py.Dataset:
    """One column, opened only once its link is known to stay within the file."""
    if file.id.links.get_info(name.encode()).type != h5l.TYPE_HARD:
        raise ValueError(f"{name} is a link, not a column")
    if h5o.get_info(file.id, name.encode()).type != h5o.TYPE_DATASET:
        raise ValueError(f"{name} is not a column")
    data = file[name]
    layout = data.id.get_create_plist()
    if layout.get_external_count() or layout.get_layout() != h5d.CHUNKED:
        raise ValueError(f"{name} is not stored in chunks in this file")
    if data.dtype != column.dtype or data.dtype.metadata:
        raise ValueError(f"{name} has type {data.dtype}, not {column.dtype}")
    _check_shape(name, data.shape, column)
    _check_chunks(name, data, column.most_bytes)
    filters = tuple(layout.get_filter(number)[0] for number in range(layout.get_nfilters()))
    if filters not in _PIPELINES:
        raise ValueError(f"{name} goes through other filters than elast's: {list(filters)}")
    return data


def _check_shape(name: str, shape: tuple[int, ...], column: Column) -> None:
    row = shape[1:]
    fits = len(shape) == 1 + len(column.row) and all(
        1 <= size <= 4096 if wanted is None else size == wanted
        for size, wanted in zip(row, column.row, strict=True)
    )
    if not fits or shape[0] < 1:
        wanted = ", ".join(["rows", *("any" if size is None else str(size) for size in column.row)])
        raise ValueError(f"{name} has shape {shape}, not ({wanted})")


def _check_chunks(name: str, data: h5py.Dataset, most: int) -> None:
    """Every chunk is there, small, and no longer than what it stands for."""
    chunk_bytes = math.prod(data.chunks) * data.dtype.itemsize
    if chunk_bytes > MAX_CHUNK_BYTES:
        raise ValueError(f"{name} has chunks of {chunk_bytes} bytes, more than {MAX_CHUNK_BYTES}")
    if data.nbytes > most:
        raise ValueError(f"{name} declares {data.nbytes} bytes, more than {most}")
    expected = math.prod(
        -(-size // chunk) for size, chunk in zip(data.shape, data.chunks, strict=True)
    )
    if data.chunks[1:] != data.shape[1:]:
        raise ValueError(f"{name} has chunks of {data.chunks}, which are not of whole rows")
    sizes: list[int] = []
    skipped: list[int] = []

    def look(chunk: Any) -> None:
        sizes.append(chunk.size)
        skipped.append(chunk.filter_mask)

    data.id.chunk_iter(look)
    if len(sizes) != expected:
        raise ValueError(f"{name} has {len(sizes)} of {expected} chunks")
    if max(sizes) > chunk_bytes + chunk_bytes // 100 + 64:
        raise ValueError(f"{name} has a chunk that is longer than its content")
    if max(skipped) > (1 if data.compression else 0):  # deflating alone may have been left out
        raise ValueError(f"{name} has a chunk without its checksum")
