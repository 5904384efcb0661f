"""Datasets that are damaged or contradict themselves: refused, naming the episode."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError
from tests.toys.datasets import ROWS, columns, refused, save
from tests.toys.hostile import bounded

pytestmark = pytest.mark.timeout(30)


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with bounded():
        yield


def test_the_dataset_that_the_hostile_ones_are_made_from_is_valid(tmp_path: Path) -> None:
    assert Dataset.load(save(tmp_path / "data.h5", columns())).episodes == 3


def put(name: str, where: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        data[name][where] = value

    return change


def cut(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.update({name: data[name][:-1]})


INCONSISTENT: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "NaN in an action": (put("action", 4, np.nan), "episode 1 step 1: an action before the last"),
    "infinity in an action": (put("action", (7, 0), np.inf), "episode 2 step 0: an action before"),
    "an action beyond its box": (
        put("action", (3, 1), -1.001),
        "episode 1 step 0: an action is out",
    ),
    "an action at the end": (put("action", 2, 0.5), "episode 0 step 2: the last row's action"),
    "half an action at the end": (put("action", (2, 1), 0.5), "episode 0 step 2: the last row's"),
    "NaN in a state": (put("state", (6, 1), np.nan), "episode 1 step 3: a state is not finite"),
    "ends that do not increase": (put("ep_len", 1, 0), "episode 1 has fewer than 2 rows"),
    "a negative length": (put("ep_len", 0, -3), "episode 0 has fewer than 2 rows"),
    "overlapping episodes": (put("ep_offset", 2, 5), "episode 2 does not begin where"),
    "a shifted first episode": (put("ep_offset", 0, 1), "episode 0 does not begin where"),
    "an episode past the end": (put("ep_len", 2, 2**31 - 1), "episode 2 ends after the last row"),
    "a last episode too short": (cut("ep_len"), "ep_len has 2 rows, ep_offset 3"),
    "rows of no episode": (
        lambda d: d.update(ep_len=d["ep_len"][:2], ep_offset=d["ep_offset"][:2]),
        "episode 1 ends at row 7 of 9",
    ),
    "a step that does not count": (put("step_idx", 5, 9), "episode 1 step 2: step_idx"),
    "an episode that does not count": (put("ep_idx", 5, 0), "episode 1 step 2: ep_idx"),
    "a later first episode": (
        lambda d: d.update(ep_idx=d["ep_idx"] + np.int32(4)),
        "begins with episode 4, not 0",
    ),
    "too few actions": (cut("action"), "action has 8 rows, the episodes 9"),
    "too few states": (cut("state"), "state has 8 rows, the episodes 9"),
    "too few pixels": (cut("pixels"), "pixels has 8 rows, the episodes 9"),
    "a blank first frame": (
        lambda d: d.update(pixels=np.zeros((ROWS + 1, 64, 64, 3), np.uint8)),
        "pixels has 10 rows, the episodes 9",
    ),
    "no pixels": (lambda d: d.pop("pixels"), "column 'pixels' is missing"),
    "an unknown column": (lambda d: d.update(reward=d["ep_idx"]), "unknown column 'reward'"),
    "small frames": (
        lambda d: d.update(pixels=np.zeros((ROWS, 32, 32, 3), np.uint8)),
        r"pixels has shape \(9, 32, 32, 3\), not \(rows, 64, 64, 3\)",
    ),
}


@pytest.mark.parametrize("case", INCONSISTENT)
def test_an_inconsistent_dataset_is_refused_naming_the_episode(tmp_path: Path, case: str) -> None:
    change, message = INCONSISTENT[case]
    data = columns()
    change(data)
    refused(save(tmp_path / "data.h5", data), message)


def test_a_truncated_dataset_is_refused(tmp_path: Path) -> None:
    content = save(tmp_path / "data.h5", columns()).read_bytes()
    for size in (0, 7, 100, len(content) // 2, len(content) - 1):
        (tmp_path / "cut.h5").write_bytes(content[:size])
        refused(tmp_path / "cut.h5", "not a readable dataset")


def test_a_damaged_chunk_names_its_episodes(tmp_path: Path) -> None:
    data = columns()
    data["pixels"] += np.arange(ROWS, dtype=np.uint8)[:, None, None, None]
    path = save(tmp_path / "data.h5", data)
    content = bytearray(path.read_bytes())
    content[content.index(bytes([4]) * 100)] ^= 1  # in the frame of row 4
    path.write_bytes(content)
    refused(path, "pixels is damaged in episode 0 step 0 to episode 2 step 1")


def test_no_single_bit_flip_is_silently_wrong(tmp_path: Path) -> None:
    data = columns()
    data["pixels"] = np.random.default_rng(0).integers(0, 256, data["pixels"].shape, np.uint8)
    path = save(tmp_path / "data.h5", data)
    content = path.read_bytes()
    for bit in np.random.default_rng(1).integers(0, 8 * len(content), 60):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << (bit % 8)
        (tmp_path / "flipped.h5").write_bytes(flipped)
        try:
            found = Dataset.load(tmp_path / "flipped.h5")
            np.testing.assert_array_equal(found.pixels[:], data["pixels"])
        except DataError:
            continue
        for name in ("action", "state", "ep_len", "ep_offset"):
            np.testing.assert_array_equal(getattr(found, name), data[name])


def test_a_folder_or_a_pipe_is_no_dataset(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe"):
        refused(path, "not a regular file")
