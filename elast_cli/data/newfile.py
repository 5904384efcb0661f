"""A new file that HDF5 writes piece by piece; failures of the disk are kept from HDF5."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


class NewFile:
    """The file object that h5py writes to: HDF5 itself crashes on a full disk.

    After the first error nothing more goes to disk. What HDF5 writes then is held in memory, where
    it is read again; so call `check` before that is much, and at the end.
    """

    def __init__(self, path: Path) -> None:
        """Create the file. Raises FileExistsError if there is one."""
        self.path = path
        self._file = path.open("xb+", buffering=0)
        self._error: OSError | None = None
        self._held: dict[int, bytes] = {}  # place -> content, in the order of writing

    def check(self) -> None:
        """Raise the OSError that writing has met, if any."""
        if self._error:
            raise self._error

    def finish(self) -> None:
        """Put everything on disk and close the file. Raises OSError if that is not possible."""
        self.check()
        os.fsync(self._file.fileno())
        self._file.close()

    def remove(self) -> None:
        """Close and remove the file."""
        self.path.unlink(missing_ok=True)
        with suppress(OSError):
            self._file.close()

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, as files do."""
        return self._file.seek(place, whence)

    def tell(self) -> int:
        """Where the file stands."""
        return self._file.tell()

    def write(self, content: memoryview) -> int:
        """Write all of it, or hold it in memory."""
        place, rest = self.tell(), memoryview(content).cast("B")
        size = len(rest)
        try:
            while len(rest) and not self._error:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._error = error
        if self._error:
            self._held.pop(place, None)
            self._held[place] = bytes(content)
            self.seek(place + size)
        return size

    def readinto(self, content: memoryview) -> int:
        """Read what was written, be it on disk or in memory."""
        place, found = self.tell(), memoryview(content).cast("B")
        size, done = len(found), 0
        while done < size and (count := self._file.readinto(found[done:])):
            done += count
        for begin, held in self._held.items():
            first, last = max(begin, place), min(begin + len(held), place + size)
            if first < last:
                found[first - place : last - place] = held[first - begin : last - begin]
                done = max(done, last - place)
        self.seek(place + done)
        return done

    def read(self, size: int) -> bytes:
        """Read up to so many bytes; h5py knows a file object by it."""
        content = bytearray(size)
        return bytes(content[: self.readinto(memoryview(content))])

    def truncate(self, size: int) -> int:
        """Give the file a length."""
        try:
            return self._file.truncate(size)
        except OSError as error:
            self._error = self._error or error
            return size

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""
