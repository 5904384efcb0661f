"""Files: whole or absent, regular only, and every disk error as one line."""

from __future__ import annotations

import errno
import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from elast_cli.errors import ElastError, MissingInputError, StorageError


def read_regular(path: Path, *, error: type[ElastError], max_bytes: int) -> bytes:
    """The bytes of a regular file; never waits on a FIFO and never reads past `max_bytes`."""
    try:
        with open_regular(path) as file:
            content = file.read(max_bytes + 1)
    except FileNotFoundError:
        raise MissingInputError(f"{path}: no such file") from None
    except (OSError, ValueError) as reason:
        raise error(f"{path}: cannot be read: {one_line(reason)}") from None
    if len(content) > max_bytes:
        raise error(f"{path}: larger than {max_bytes} bytes")
    return content


def open_regular(path: Path) -> io.BufferedReader:
    """An open regular file, never a folder, FIFO or device. Raises ValueError for those."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise ValueError("not a regular file")
    return open(handle, "rb")


def one_line(reason: object) -> str:
    """An error's text on one line of at most 500 characters."""
    return " ".join(str(reason).split())[:500]


_DISK_ERRORS = frozenset(
    {errno.EACCES, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOSPC, errno.EPERM, errno.EROFS}
)


@contextmanager
def storage_errors() -> Iterator[None]:
    """Turn a full, read-only or failing disk into a one-line StorageError."""
    try:
        yield
    except OSError as reason:
        if reason.errno not in _DISK_ERRORS:
            raise
        text = " ".join(str(reason).split())[:300]
        raise StorageError(
            f"storage failed: {text}; free some space or set ELAST_HOME to a writable folder"
        ) from reason


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to fill that then stands at `path`, whole and on disk, or is not there at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Put a folder's entries on disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
