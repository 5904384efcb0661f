"""What an interrupted evaluation continues from."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from elast_cli.stages.done_episodes import read_frames, read_row, write_frames, write_row
from tests.toys.episodes import episode


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one episode."""
    write_row(tmp_path, episode(7, level="hard"))
    frames = np.arange(2 * 64 * 64 * 3, dtype=np.uint8).reshape(2, 64, 64, 3)
    write_frames(tmp_path, "hard", 7, frames, frames[0])
    return tmp_path


def test_episodes_come_back_as_they_were(folder: Path) -> None:
    assert read_row(folder, "hard", 7) == episode(7, level="hard")
    found = read_frames(folder, "hard", 7)
    assert found is not None
    assert (found[0][0] == found[1]).all()
    assert read_row(folder, "hard", 8) is None
    assert read_frames(folder, "hard", 8) is None


def test_no_flipped_bit_goes_unnoticed(folder: Path) -> None:
    for path, read in zip(sorted(folder.iterdir()), (read_row, read_frames), strict=True):
        whole = path.read_bytes()
        for at in np.random.default_rng(0).integers(8 * len(whole), size=200):
            flipped = bytearray(whole)
            flipped[at // 8] ^= 1 << int(at % 8)
            path.write_bytes(flipped)
            assert read(folder, "hard", 7) is None
        for length in (0, 10, len(whole) - 1):
            path.write_bytes(whole[:length])
            assert read(folder, "hard", 7) is None


def test_an_episode_in_anothers_place_does_not_count(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        path.rename(folder / path.name.replace("7", "8"))
    assert read_row(folder, "hard", 8) is None
    assert read_frames(folder, "hard", 8) is None


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_file_is_not_waited_for(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "hard-000000.json")
    make(tmp_path / "hard-000000.npz")
    assert read_row(tmp_path, "hard", 0) is None
    assert read_frames(tmp_path, "hard", 0) is None
