"""Images of a file: read when they are asked for, a chunk at a time, checked when they are read."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

from elast_cli.data import images as data_images
from elast_cli.data.dataset import Dataset
from elast_cli.data.images import BLOCK, Images, blocks
from elast_cli.data.shards import compact
from elast_cli.errors import DataError
from elast_cli.shapes import Int64
from tests.toys.episode_files import STEPS, episode, flat, write_all, write_cut


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A dataset of four episodes with contexts: 92 rows, in two chunks of images."""
    episodes = [episode(index, steps, context=True) for index, steps in enumerate(STEPS)]
    compact(write_all(tmp_path, episodes), tmp_path / "out.h5")
    return tmp_path / "out.h5"


def damage(path: Path, column: str, row: int) -> None:
    """Flip one bit in the middle of the chunk that begins at a row."""
    with h5py.File(path) as file:
        info = file[column].id.get_chunk_info_by_coord((row, 0, 0, 0))
    with path.open("r+b") as disk:
        disk.seek(info.byte_offset + info.size // 2)
        byte = disk.read(1)[0]
        disk.seek(-1, 1)
        disk.write(bytes([byte ^ 16]))


@pytest.mark.parametrize(
    "rows",
    [[], [0], [91], [70, 3, 70, 91, 0], list(range(92))],
    ids=["none", "first", "last", "any order", "all"],
)
def test_rows_are_given_in_the_order_asked_for(path: Path, rows: list[int]) -> None:
    with h5py.File(path) as file:
        expected = file["pixels"][:][rows]
    found = Dataset.load(path).pixels[np.array(rows, np.int64)]
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, expected.reshape(found.shape))


def test_a_slice_is_a_slice(path: Path) -> None:
    pixels = Dataset.load(path).pixels
    whole = pixels[:]
    for part in (slice(5, 70), slice(None, None, 7), slice(-3, None), slice(200, 300)):
        np.testing.assert_array_equal(pixels[part], whole[part])
    assert pixels.shape == whole.shape
    assert len(pixels) == len(whole)


@pytest.mark.parametrize("row", [-1, 92])
def test_a_row_that_is_not_there_is_refused(path: Path, row: int) -> None:
    with pytest.raises(DataError, match=f"pixels has no row {row}, only 92"):
        _ = Dataset.load(path).pixels[np.array([row])]


def test_contexts_are_those_of_the_episodes_asked_for(path: Path) -> None:
    context = Dataset.load(path).context
    assert context is not None
    assert context.shape == (4, 8, 8, 3)
    for row, index in enumerate((2, 0)):
        expected = episode(index, STEPS[index], context=True).context
        np.testing.assert_array_equal(context[np.array([2, 0])][row], expected)


def test_blocks_are_all_rows_in_order(tmp_path: Path) -> None:
    write_all(tmp_path, [flat(0, BLOCK + 9)])
    compact([next(tmp_path.glob("*.h5"))], tmp_path / "out.h5")
    pixels = Dataset.load(tmp_path / "out.h5").pixels
    found = list(blocks(pixels))
    assert [len(part) for _, part in found] == [BLOCK, 10]
    np.testing.assert_array_equal(np.concatenate([rows for rows, _ in found]), range(BLOCK + 10))
    np.testing.assert_array_equal(np.concatenate([part for _, part in found]), pixels[:])


def test_a_damaged_chunk_is_one_line_that_names_its_episodes_once_it_is_read(path: Path) -> None:
    damage(path, "pixels", 64)
    pixels = Dataset.load(path).pixels
    assert len(pixels[:64]) == 64
    for rows in (slice(60, 70), np.array([3, 91])):
        with pytest.raises(DataError) as caught:
            _ = pixels[rows]
        words = "pixels is damaged in episode 1 step 58 to episode 3 step 12"
        assert str(caught.value) == f"{path}: {words}"


def test_a_damaged_context_names_its_episodes(path: Path) -> None:
    damage(path, "context", 0)
    context = Dataset.load(path).context
    assert context is not None
    with pytest.raises(DataError, match="context is damaged in episode 0 step 0 to episode 1"):
        _ = context[:]


def test_opening_reads_no_image(path: Path) -> None:
    for column in ("pixels", "context"):
        for row in (0, 64):
            damage(path, column, row)
    assert Dataset.load(path).episodes == len(STEPS)


def test_a_file_that_was_replaced_is_still_the_one_that_was_opened(path: Path) -> None:
    pixels = Dataset.load(path).pixels
    before = pixels[:]
    path.unlink()
    path.write_bytes(b"another file")
    np.testing.assert_array_equal(pixels[:], before)


def test_a_file_is_closed_with_the_last_that_refers_to_it(path: Path) -> None:
    dataset = Dataset.load(path)
    pixels: Images = dataset.pixels
    column = pixels._column  # type: ignore[attr-defined] # of StoredImages
    del dataset
    assert column
    del pixels
    gc.collect()
    assert not column


def test_no_more_than_a_few_chunks_are_held_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compact(write_cut(tmp_path, [[flat(0, 4999)]]), tmp_path / "out.h5")  # 61 MB of images
    pixels = Dataset.load(tmp_path / "out.h5").pixels
    sizes: list[int] = []

    def counted(self: data_images.StoredImages, first: int) -> object:
        piece = known(self, first)
        sizes.append(piece.nbytes)
        return piece

    known = data_images.StoredImages._read
    monkeypatch.setattr(data_images.StoredImages, "_read", counted)
    rows: Int64 = np.arange(0, 5000, 250)
    assert pixels[rows].nbytes == 20 * 64 * 64 * 3
    assert len(sizes) == 20
    assert max(sizes) == 64 * 64 * 64 * 3


def test_compaction_holds_no_file_in_memory(tmp_path: Path) -> None:
    shards = write_cut(tmp_path, [[episode(part, 255)] for part in range(12)])  # 38 MB of noise
    tracemalloc.start()
    compact(shards, tmp_path / "out.h5")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (tmp_path / "out.h5").stat().st_size > 37_000_000
    assert most < 12_000_000
