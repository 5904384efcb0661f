"""Arrays that were computed before: the same bits, or computed anew."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from elast_cli.config import JsonDict
from elast_cli.data.cache import ArrayCache
from elast_cli.shapes import Float32

SHAPE = (5, 3)
KEY: JsonDict = {"what": "a test", "of": [1, 2]}


class Made:
    """Makes an array and counts how often."""

    def __init__(self, shape: tuple[int, ...] = SHAPE) -> None:
        self.array = np.random.default_rng(0).normal(size=shape).astype(np.float32)
        self.times = 0

    def __call__(self) -> Float32:
        self.times += 1
        return self.array


def only(folder: Path) -> Path:
    """The one entry of a cache."""
    [path] = folder.iterdir()
    return path


def test_an_array_is_made_once(tmp_path: Path) -> None:
    made = Made()
    for _ in range(3):
        found = ArrayCache(tmp_path / "new" / "cache").array(KEY, SHAPE, made)
        assert found.tobytes() == made.array.tobytes()
    assert made.times == 1


@pytest.mark.parametrize("shape", [(0, 3), (4, 0)])
def test_arrays_of_nothing_are_arrays(tmp_path: Path, shape: tuple[int, ...]) -> None:
    made = Made(shape)
    for _ in range(2):
        assert ArrayCache(tmp_path).array(KEY, shape, made).shape == shape
    assert made.times == 1


def test_another_key_or_another_size_is_another_array(tmp_path: Path) -> None:
    cache = ArrayCache(tmp_path)
    cache.array(KEY, SHAPE, Made())
    other: JsonDict = {**KEY, "more": 1}
    for key, shape in ((other, SHAPE), (KEY, (5, 4)), (KEY, (4, 3))):
        made = Made(shape)
        assert cache.array(key, shape, made) is made.array


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def longer(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\0")


def changed(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def linked(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to(path.with_name("elsewhere"))


def piped(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize("harm", [cut, longer, changed, emptied, linked, piped])
def test_a_damaged_entry_is_made_anew(tmp_path: Path, harm: object) -> None:
    made, cache = Made(), ArrayCache(tmp_path / "cache")
    cache.array(KEY, SHAPE, made)
    entry = only(tmp_path / "cache")
    assert callable(harm)
    harm(entry)
    assert cache.array(KEY, SHAPE, made).tobytes() == made.array.tobytes()
    assert made.times == 2
    assert cache.array(KEY, SHAPE, made).tobytes() == made.array.tobytes()
    assert made.times == 2, "it was not put right"
    assert not entry.is_symlink()


def test_the_entry_of_another_key_is_not_taken_for_this_one(tmp_path: Path) -> None:
    cache, made = ArrayCache(tmp_path), Made()
    cache.array(KEY, SHAPE, made)
    first = only(tmp_path)
    cache.array({"other": 1}, SHAPE, Made())
    [second] = set(tmp_path.iterdir()) - {first}
    first.replace(second)
    other = Made()
    cache.array({"other": 1}, SHAPE, other)
    assert other.times == 1


def test_a_folder_that_cannot_be_written_to_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    for folder in (tmp_path / "file" / "cache", tmp_path / "file", tmp_path / "link"):
        made = Made()
        assert ArrayCache(folder).array(KEY, SHAPE, made) is made.array
        assert ArrayCache(folder).array(KEY, SHAPE, made) is made.array
        assert made.times == 2
    assert list((tmp_path / "real").iterdir()) == []


def test_the_oldest_entries_make_room_and_what_is_too_large_is_not_kept(tmp_path: Path) -> None:
    cache = ArrayCache(tmp_path, most_bytes=400)
    for number in range(4):  # each of 125 bytes
        cache.array({"number": number}, SHAPE, Made())
        for age, path in enumerate(sorted(tmp_path.iterdir(), key=lambda p: p.stat().st_mtime_ns)):
            os.utime(path, ns=(age, age))
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 400
    for number, kept in enumerate((False, True, True, True)):
        made = Made()
        cache.most_bytes = 10_000
        cache.array({"number": number}, SHAPE, made)
        assert made.times == (0 if kept else 1)
    cache.most_bytes = 100
    (tmp_path / "notes.txt").write_text("mine")
    before = set(tmp_path.iterdir())
    cache.array({"number": 9}, SHAPE, Made())
    assert set(tmp_path.iterdir()) == before
