"""Locks between processes, also on file systems that have none."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import BaseFileLock, FileLock, SoftFileLock, Timeout

from elast_cli.errors import BusyError, StorageError
from elast_cli.files import make_folders, refuse_links

LOCKS = ".locks"
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}  # a network disk without a lock daemon

Note = Callable[[str], None]


@contextmanager
def held(
    root: Path, name: str, *, busy: str = "", wait: bool = True, note: Note | None = None
) -> Iterator[None]:
    """Hold the lock `name` of the store folder `root`.

    The lock file is kept, because waiting processes may hold it open. If the file system has no
    locks, an exclusively created file serves as one, and a note says so.

    Args:
        root: of the store's artifacts.
        name: of the lock.
        busy: what the holder does, for the message of a process that waits.
        wait: wait for the holder.
        note: called before waiting.

    Raises:
        BusyError: another process holds it and `wait` is false.
        StorageError: there can be no lock, such as where a folder stands in its place.
    """
    lock = _acquired(root, name, busy=busy, wait=wait, note=note)
    try:
        yield
    finally:
        lock.release()


def supported(folder: Path) -> bool:
    """Whether the file system of a folder has locks; a file in it is made and removed again."""
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".elast-lock-") as file:
        try:
            FileLock(file.name).acquire(blocking=False).lock.release()
        except (OSError, NotImplementedError) as reason:
            if not _lacks_locks(reason):
                raise
            return False
    return True


def _lacks_locks(reason: OSError | NotImplementedError) -> bool:
    return isinstance(reason, NotImplementedError) or reason.errno in _NO_LOCKS


def _acquired(root: Path, name: str, *, busy: str, wait: bool, note: Note | None) -> BaseFileLock:
    folder = root / LOCKS
    refuse_links(folder)
    make_folders(folder)
    path = folder / f"{name}.lock"
    if os.path.lexists(path) and (path.is_symlink() or not path.is_file()):
        raise StorageError(f"{path}: not a regular file, so it cannot be a lock; remove it")
    try:
        return _wait_for(FileLock(path), busy=busy, wait=wait, note=note)
    except (OSError, NotImplementedError) as reason:
        if not _lacks_locks(reason):
            raise
        if note:
            note(f"{root} has no file locks; a file that is created exclusively stands for one")
        soft = SoftFileLock(folder / f"{name}.exclusive")
        return _wait_for(soft, busy=busy, wait=wait, note=note)


def _wait_for(lock: BaseFileLock, *, busy: str, wait: bool, note: Note | None) -> BaseFileLock:
    try:
        lock.acquire(blocking=False)
    except Timeout:
        if not wait:
            raise BusyError(f"{busy}; without --no-wait elast waits for it") from None
        if note and busy:
            note(f"{busy}; waiting for it")
        lock.acquire()
    return lock
