"""A cache of arrays that can be recomputed: an entry is whole and verified, or absent."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.errors import StorageError
from elast_cli.files import make_folders, open_regular, refuse_links, whole_file
from elast_cli.shapes import Float32

MOST_BYTES = 4 << 30  # of all files together; the oldest go first
_ENTRY = re.compile(r"\.?[0-9a-f]{64}\.f32(\.[0-9]+)?")  # names of entries, also of unfinished ones
_HEAD = 65  # bytes of a first line


class ArrayCache:
    """Arrays float32 by key, one file each: a SHA-256 in hexadecimal, a line feed, the numbers.

    The SHA-256 covers key and numbers. A damaged entry is computed again. If the folder is not
    writable, nothing is kept, without an error.
    """

    def __init__(self, folder: Path, *, most_bytes: int = MOST_BYTES) -> None:
        """A cache in `folder`, which need not exist yet."""
        self.folder, self.most_bytes = folder, most_bytes

    def array(self, key: JsonDict, shape: tuple[int, ...], make: Callable[[], Float32]) -> Float32:
        """The array of a key, of `shape`; `make` computes it unless it is there.

        Args:
            key: everything that the numbers depend on, as JSON.
            shape: of the array.
            make: computes the array f32, in that shape.
        """
        name = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
        path = self.folder / f"{name}.f32"
        found = self._read(path, name, shape)
        if found is None:
            found = make()
            self._write(path, name, found)
        return found

    def _read(self, path: Path, name: str, shape: tuple[int, ...]) -> Float32 | None:
        """What is stored, if it is what the key and its SHA-256 say."""
        found = np.empty(shape, np.float32)
        content = _bytes(found)
        try:
            refuse_links(self.folder, path)
            with open_regular(path) as file:
                head = file.readline(_HEAD)
                whole = file.readinto(content) == len(content) and not file.read(1)
        except (OSError, ValueError, StorageError):
            return None
        return found if whole and head == _head(name, content) else None

    def _write(self, path: Path, name: str, array: Float32) -> None:
        """Keep an array, if the disk allows it."""
        content = _bytes(np.ascontiguousarray(array))
        with suppress(OSError, StorageError):
            refuse_links(self.folder)
            make_folders(self.folder)
            if self._make_room(_HEAD + len(content)):
                with whole_file(path) as file:
                    file.write(_head(name, content))
                    file.write(content)

    def _make_room(self, size: int) -> bool:
        """Remove the oldest entries until `size` bytes fit; False if they never do."""
        if size > self.most_bytes:
            return False
        entries = [(path.stat(), path) for path in self.folder.iterdir() if _is_entry(path)]
        used = sum(status.st_size for status, _ in entries)
        for status, path in sorted(entries, key=lambda entry: entry[0].st_mtime_ns):
            if used + size > self.most_bytes:
                path.unlink(missing_ok=True)
                used -= status.st_size
        return True


def _is_entry(path: Path) -> bool:
    """Whether a path is a file that a cache has made."""
    return bool(_ENTRY.fullmatch(path.name)) and path.is_file() and not path.is_symlink()


def _bytes(array: Float32) -> memoryview:
    """The memory of a contiguous array."""
    return array.reshape(-1).data.cast("B") if array.size else memoryview(bytearray())


def _head(name: str, content: memoryview) -> bytes:
    """The first line of an entry."""
    digest = hashlib.sha256(name.encode())
    digest.update(content)
    return digest.hexdigest().encode() + b"\n"
