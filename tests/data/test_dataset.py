"""Datasets: shards, compaction, windows and the layout that other readers rely on."""

from __future__ import annotations

import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.data import layout
from elast_cli.data.dataset import Dataset, Episode
from elast_cli.data.layout import column_digests
from elast_cli.data.shards import compact, write_shard
from elast_cli.errors import DataError
from tests.toys.episode_files import STEPS, episode, flat, write_all, write_cut


def stored(path: Path, row: int) -> bytes:
    """The chunk of frames that begins at a row, as it is on disk."""
    with h5py.File(path) as file:
        content: bytes = file["pixels"].id.read_direct_chunk((row, 0, 0, 0))[1]
    return content


def in_memory(lengths: list[int]) -> Dataset:
    length = np.array(lengths, np.int32)
    rows = int(length.sum())
    return Dataset(
        pixels=np.zeros((rows, 64, 64, 3), np.uint8),
        action=np.zeros((rows, 2), np.float32),
        state=np.zeros((rows, 2), np.float32),
        ep_len=length,
        ep_offset=np.cumsum(length, dtype=np.int64) - length,
        context=None,
    )


@pytest.mark.parametrize("context", [False, True])
def test_a_shard_gives_its_episodes_back(tmp_path: Path, context: bool) -> None:
    written = [episode(index, steps, context=context) for index, steps in ((7, 9), (8, 70))]
    write_shard(tmp_path / "shard.h5", written)
    read = layout.read(tmp_path / "shard.h5")
    assert read.first_episode == 7
    assert read.numbers["ep_len"].tolist() == [10, 71]
    for name, found in (("pixels", read.pixels[:]), *read.numbers.items()):
        if hasattr(written[0], name):
            expected = np.concatenate([getattr(one, name) for one in written])
            np.testing.assert_array_equal(found, expected)
    assert (read.context is not None) == context
    if read.context:
        np.testing.assert_array_equal(read.context[:], [one.context for one in written])


@pytest.mark.parametrize("context", [False, True])
def test_a_dataset_is_its_episodes_end_to_end(tmp_path: Path, context: bool) -> None:
    episodes = [episode(index, steps, context=context) for index, steps in enumerate(STEPS)]
    compact(write_all(tmp_path, episodes), tmp_path / "out.h5")
    data = Dataset.load(tmp_path / "out.h5")
    assert data.episodes == len(STEPS)
    assert data.ep_len.tolist() == [steps + 1 for steps in STEPS]
    assert data.ep_offset.tolist() == [0, 6, 77, 79]
    np.testing.assert_array_equal(data.pixels[:], np.concatenate([one.pixels for one in episodes]))
    np.testing.assert_array_equal(data.action, np.concatenate([one.action for one in episodes]))
    np.testing.assert_array_equal(data.state, np.concatenate([one.state for one in episodes]))
    assert (data.context is not None) == context
    if data.context is not None:
        images = [one.context for one in episodes if one.context is not None]
        np.testing.assert_array_equal(data.context[:], np.stack(images))


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (replace(episode(1, 3), context=None), "has rows"),
        (replace(episode(1, 3), context=np.zeros((4, 4, 3), np.uint8)), "has rows"),
        (replace(episode(1, 3), context=np.zeros((8, 8, 3), np.float32)), "float32"),
        (replace(episode(1, 3), state=np.zeros((4, 9), np.float32)), "has rows"),
    ],
)
def test_episodes_that_do_not_go_together_are_refused(
    tmp_path: Path, other: Episode, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        write_shard(tmp_path / "shard.h5", [episode(0, 3, context=True), other])
    with pytest.raises(DataError, match="no episodes"):
        write_shard(tmp_path / "shard.h5", [])
    assert list(tmp_path.iterdir()) == []


def test_equal_images_are_compressed_equally_in_every_process(tmp_path: Path) -> None:
    program = """
import os, random, sys
from pathlib import Path
import numpy as np
from elast_cli.data.dataset import Episode
from elast_cli.data.shards import write_shard
junk = [os.urandom(random.randint(1_000, 400_000)) for _ in range(40)]  # what memory held before
del junk
rng = np.random.default_rng(0)
frames = np.full((9_600, 64, 64, 3), 240, np.uint8)
for frame, (x, y) in zip(frames, rng.integers(0, 56, (len(frames), 2))):
    frame[y : y + 8, x : x + 8] = rng.integers(0, 256, (8, 8, 3))
action = np.zeros((len(frames), 1), np.float32)
action[-1] = np.nan
write_shard(Path(sys.argv[1]), [Episode(frames, action, action * 0 + 1, None, 0)])
"""
    files = [tmp_path / f"{number}.h5" for number in range(3)]
    for file in files:
        subprocess.run([sys.executable, "-c", program, str(file)], check=True)
    assert len({file.read_bytes() for file in files}) == 1


def test_images_need_not_lie_in_one_piece(tmp_path: Path) -> None:
    one = episode(0, 5)
    turned = replace(one, pixels=np.asfortranarray(one.pixels))
    write_shard(tmp_path / "shard.h5", [turned])
    np.testing.assert_array_equal(layout.read(tmp_path / "shard.h5").pixels[:], one.pixels)


def test_the_same_shards_make_the_same_bytes(tmp_path: Path) -> None:
    shards = write_all(tmp_path, [episode(index, steps) for index, steps in enumerate(STEPS)])
    for name in ("one.h5", "two.h5"):
        compact(shards, tmp_path / name, attrs={"env": "block-s", "seed": 3})
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 140), st.booleans()), min_size=2, max_size=5), st.booleans()
)
def test_a_dataset_does_not_depend_on_how_shards_were_cut(
    episodes: list[tuple[int, bool]], noise: bool
) -> None:
    made = [(episode if noise else flat)(i, steps) for i, (steps, _) in enumerate(episodes)]
    parts: list[list[Episode]] = [[]]
    for one, (_, cut) in zip(made, episodes, strict=True):
        parts += [[]] if cut and parts[-1] else []
        parts[-1].append(one)
    with TemporaryDirectory() as name:
        folder = Path(name)
        compact(write_cut(folder, parts), folder / "cut.h5")
        write_shard(folder / "whole.h5", made)
        assert column_digests(folder / "cut.h5") == column_digests(folder / "whole.h5")
        with h5py.File(folder / "cut.h5") as cut_file, h5py.File(folder / "whole.h5") as whole:
            assert all(cut_file[name].chunks == whole[name].chunks for name in whole)


@pytest.mark.parametrize("lead", [0, 10])
def test_whole_chunks_are_copied_as_they_are_stored(tmp_path: Path, lead: int) -> None:
    parts = [[flat(0, 64 + lead - 1)], [flat(1, 190 - lead)]]
    shards = write_cut(tmp_path, parts)
    with h5py.File(shards[1], "r+") as file:  # another level tells a copy from new compression
        column = file["pixels"]
        chunk = zlib.compress(column[64:128].tobytes(), 9)
        column.id.write_direct_chunk((64, 0, 0, 0), chunk + checksum(chunk))
    compact(shards, tmp_path / "out.h5")
    assert stored(tmp_path / "out.h5", 128) == stored(shards[1], 64)
    whole = np.concatenate([part[0].pixels for part in parts])
    np.testing.assert_array_equal(Dataset.load(tmp_path / "out.h5").pixels[:], whole)


def checksum(content: bytes) -> bytes:
    """HDF5's Fletcher-32, word by word."""
    low = high = 0
    for place in range(0, len(content), 2):
        word = int.from_bytes(content[place : place + 2].ljust(2, b"\0"), "big")
        low = (low + word) % 65535
        high = (high + low) % 65535
    return ((high or 65535) << 16 | (low or 65535)).to_bytes(4, "little")


@pytest.mark.parametrize("row", [0, 64])
@pytest.mark.parametrize("noise", [False, True])
def test_a_damaged_chunk_is_never_copied(tmp_path: Path, row: int, noise: bool) -> None:
    [shard] = write_cut(tmp_path, [[(episode if noise else flat)(0, 127)]])
    content = stored(shard, row)
    place = shard.read_bytes().index(content) + len(content) // 2
    with open(shard, "r+b") as file:
        file.seek(place)
        byte = file.read(1)[0]
        file.seek(place)
        file.write(bytes([byte ^ 16]))
    words = f"pixels is damaged in episode 0 step {row} to episode 0 step {row + 63}"
    with pytest.raises(DataError, match=words):
        compact([shard], tmp_path / "out.h5")
    assert not (tmp_path / "out.h5").exists()


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    shards = write_all(tmp_path, [episode(0, 2)])
    (tmp_path / "out.h5").write_text("mine")
    with pytest.raises(FileExistsError):
        compact(shards, tmp_path / "out.h5")
    assert (tmp_path / "out.h5").read_text() == "mine"


def test_the_layout_is_flat_with_one_value_a_row(tmp_path: Path) -> None:
    episodes = [episode(index, steps, context=True) for index, steps in enumerate(STEPS)]
    compact(write_all(tmp_path, episodes), tmp_path / "out.h5", attrs={"env": "block-s"})
    with h5py.File(tmp_path / "out.h5") as file:
        assert file.attrs["env"] == "block-s"
        assert all(isinstance(column, h5py.Dataset) for column in file.values())
        assert all(column.fletcher32 for column in file.values())
        rows = {name: len(column) for name, column in file.items()}
        assert {rows.pop("ep_len"), rows.pop("ep_offset")} == {len(STEPS)}
        assert set(rows.values()) == {sum(STEPS) + len(STEPS)}
        assert file["step_idx"][:8].tolist() == [0, 1, 2, 3, 4, 5, 0, 1]
        assert file["ep_idx"][:8].tolist() == [0] * 6 + [1] * 2
        assert file["pixels"].chunks == (64, 64, 64, 3)
        assert {name: file[name].dtype.str for name in ("ep_len", "ep_offset", "action")} == {
            "ep_len": "<i4",
            "ep_offset": "<i8",
            "action": "<f4",
        }


def test_compaction_refuses_a_shard_out_of_place_or_of_another_shape(tmp_path: Path) -> None:
    shards = write_all(tmp_path, [episode(0, 2), episode(1, 2), episode(2, 2, context=True)])
    with pytest.raises(DataError, match="begins with episode 1, not 0"):
        compact([shards[1], shards[0]], tmp_path / "swapped.h5")
    with pytest.raises(DataError, match="episode 2 has rows of another shape"):
        compact(shards, tmp_path / "mixed.h5")
    assert not list(tmp_path.glob("[!e]*.h5"))


def test_equal_columns_have_equal_digests_and_a_changed_value_shows(tmp_path: Path) -> None:
    shards = write_all(tmp_path, [episode(0, 2), episode(1, 70)])
    compact(shards, tmp_path / "one.h5", attrs={"code": "a"})
    compact(shards, tmp_path / "two.h5", attrs={"code": "b"})
    one, two = column_digests(tmp_path / "one.h5"), column_digests(tmp_path / "two.h5")
    assert one == two
    with h5py.File(tmp_path / "two.h5", "r+") as file:
        file["pixels"][70, 3, 3, 0] += 1
    changed = column_digests(tmp_path / "two.h5")
    assert {name for name in one if one[name] != changed[name]} == {"pixels"}


def test_a_split_is_by_episode_complete_and_repeatable() -> None:
    data = in_memory([3] * 40)
    train, val = data.split(0.1, 5)
    assert sorted([*train, *val]) == list(range(40))
    assert len(val) == 4
    again = data.split(0.1, 5)
    np.testing.assert_array_equal(train, again[0])
    assert data.split(0.1, 6)[1].tolist() != val.tolist()


def test_a_split_always_leaves_both_parts_something() -> None:
    train, val = in_memory([3, 3]).split(0.0, 0)
    assert (len(train), len(val)) == (1, 1)
    with pytest.raises(DataError, match="one episode"):
        in_memory([3]).split(0.1, 0)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(2, 9), min_size=1, max_size=6), st.integers(0, 10))
def test_starts_are_exactly_the_rows_whose_window_stays_in_one_episode(
    lengths: list[int], horizon: int
) -> None:
    data = in_memory(lengths)
    chosen = np.arange(0, data.episodes, 2)
    owner = np.repeat(np.arange(data.episodes), lengths)
    rows = len(owner)
    expected = [
        row
        for row in range(rows - horizon)
        if owner[row] % 2 == 0 and owner[row] == owner[row + horizon]
    ]
    found = data.starts(chosen, horizon)
    assert found.dtype == np.int64
    assert found.tolist() == expected
