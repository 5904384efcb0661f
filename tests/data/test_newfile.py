"""New files on disks that fail: HDF5 never sees it, and no part of a file is left."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from elast_cli.data.dataset import Dataset
from elast_cli.data.newfile import NewFile
from elast_cli.data.shards import compact
from tests.toys.episode_files import episode, write_cut

LIMITED = """
import resource, sys
from pathlib import Path
from elast_cli.data.shards import compact
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
try:
    compact([Path(name) for name in sys.argv[3:]], Path(sys.argv[2]))
except OSError as error:
    print(error.strerror)
"""


def filled(disk: NewFile) -> None:
    """Write a column that HDF5 reads again while it writes."""
    with h5py.File(disk, "w", libver=("v110", "v110")) as file:
        column = file.create_dataset("x", (80_000,), "u1", chunks=(200,), fletcher32=True)
        for start in range(0, 80_000, 200):
            column[start : start + 200] = start % 251
        column[5::200] = 7


def test_a_new_file_is_what_hdf5_wrote(tmp_path: Path) -> None:
    disk = NewFile(tmp_path / "new.h5")
    filled(disk)
    disk.finish()
    with h5py.File(tmp_path / "new.h5") as file:
        found = file["x"][:].reshape(-1, 200)
    assert (found[:, 5] == 7).all()
    np.testing.assert_array_equal(found[:, 0], np.arange(0, 80_000, 200) % 251)


@pytest.mark.parametrize("size", [0, 100, 5_000, 20_000, 60_000])
def test_hdf5_never_sees_a_full_disk(
    tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = NewFile(tmp_path / "new.h5")
    known = disk._file.write

    def write(content: memoryview) -> int:
        if disk.tell() + len(content) > size:
            raise OSError(28, "No space left on device")
        return known(content)

    monkeypatch.setattr(disk, "_file", Full(disk, write))
    filled(disk)
    with pytest.raises(OSError, match="No space left"):
        disk.check()
    with pytest.raises(OSError, match="No space left"):
        disk.finish()
    disk.remove()
    assert list(tmp_path.iterdir()) == []


class Full:
    """A file with a `write` of its own."""

    def __init__(self, disk: NewFile, write: object) -> None:
        self._file, self.write = disk._file, write

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


@pytest.mark.parametrize("size", [0, 3_000, 800_000, 1_600_000])
def test_a_dataset_for_which_there_is_no_room_is_an_error_and_leaves_nothing(
    tmp_path: Path, size: int
) -> None:
    shards = write_cut(tmp_path, [[episode(0, 127)], [episode(1, 127)]])
    words = [sys.executable, "-c", LIMITED, str(size), str(tmp_path / "out.h5")]
    done = subprocess.run(
        [*words, *map(str, shards)], check=True, capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "File too large\n"
    assert not (tmp_path / "out.h5").exists()
    compact(shards, tmp_path / "out.h5")
    assert Dataset.load(tmp_path / "out.h5").episodes == 2
