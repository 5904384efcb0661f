"""Files: whole or absent, regular only, and every disk error as one line."""

from __future__ import annotations

import errno
import io
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from elast_cli.errors import ElastError, MissingInputError, StorageError

# what opening a path says that is no file, rather than a disk that fails
_NOT_A_FILE = {errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOTDIR, errno.ENXIO}


def read_regular(path: Path, *, error: type[ElastError], max_bytes: int) -> bytes:
    """The bytes of a regular file; never waits on a FIFO and never reads past `max_bytes`."""
    try:
        with open_regular(path) as file:
            content = file.read(max_bytes + 1)
    except FileNotFoundError:
        raise MissingInputError(f"{path}: no such file") from None
    except ValueError as reason:
        raise error(f"{path}: cannot be read: {one_line(reason)}") from None
    except OSError as reason:
        kind = error if reason.errno in _NOT_A_FILE else StorageError
        raise kind(f"{path}: cannot be read: {one_line(reason)}") from None
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


@contextmanager
def storage_errors() -> Iterator[None]:
    """Turn disk errors into a one-line StorageError."""
    try:
        yield
    except BrokenPipeError:
        raise  # the reader of stdout has gone
    except OSError as reason:
        text = " ".join(str(reason).split())[:300]
        raise StorageError(
            f"storage failed: {text}; free some space or set ELAST_HOME to a writable folder"
        ) from reason


def expanded(home: str | Path) -> Path:
    """$ELAST_HOME as a path, `~` and `~user` written out.

    Raises:
        StorageError: there is no such user, or their home folder is unknown.
    """
    try:
        return Path(home).expanduser()
    except RuntimeError:
        raise StorageError(
            f"ELAST_HOME: {home}: the home folder is unknown; set ELAST_HOME to a full path"
        ) from None


def make_folders(path: Path) -> None:
    """Make a folder and those above it that are missing; all of them are on disk after that."""
    if path.is_dir():
        return
    make_folders(path.parent)
    path.mkdir(exist_ok=True)
    sync_folder(path.parent)


def refuse_links(*paths: Path) -> None:
    """Raise StorageError if a path is a symbolic link: elast never writes through one."""
    for path in paths:
        if path.is_symlink():
            raise StorageError(f"{path} is a symbolic link; put a plain folder in its place")


def remove_folder(path: Path) -> None:
    """Remove a folder and all in it; links in it are removed and not followed.

    Others may remove the same folder at the same time.

    Raises:
        StorageError: it is a link itself.
    """
    refuse_links(path)

    def passed_over(_function: object, _path: str, reason: BaseException) -> None:
        if not isinstance(reason, FileNotFoundError):
            raise reason

    if sys.version_info >= (3, 12):
        shutil.rmtree(path, onexc=passed_over)
    else:
        shutil.rmtree(path, onerror=lambda f, p, info: passed_over(f, p, info[1]))


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to fill. Afterwards it is at `path`, whole and on disk, or not at all."""
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
