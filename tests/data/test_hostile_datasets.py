"""Datasets made to do harm: refused within bounds, naming what is wrong."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from h5py import h5d, h5p, h5s, h5t

from elast_cli.data.chunks import _fletcher32
from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError
from tests.toys.datasets import ROWS, SECRET, columns, refused, save
from tests.toys.hostile import bounded

pytestmark = pytest.mark.timeout(30)


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with bounded():
        yield


def external_link(file: h5py.File, other: Path) -> None:
    del file["state"]
    file["state"] = h5py.ExternalLink(str(other), "state")


def soft_link(file: h5py.File, other: Path) -> None:
    del file["state"]
    file["state"] = h5py.SoftLink("/action")


def nested_link(file: h5py.File, other: Path) -> None:
    del file["state"]
    file.create_group("state")["state"] = h5py.ExternalLink(str(other), "state")


def cycle(file: h5py.File, other: Path) -> None:
    del file["state"]
    file["state"] = file["/"]


def extra_group(file: h5py.File, other: Path) -> None:
    file.create_group("more")["loop"] = file["/"]


def external_storage(file: h5py.File, other: Path) -> None:
    del file["pixels"]
    size = ROWS * 64 * 64 * 3
    stored = [(str(other.with_suffix(".raw")), 0, size)]
    file.create_dataset("pixels", (ROWS, 64, 64, 3), np.uint8, external=stored)


def virtual(file: h5py.File, other: Path) -> None:
    del file["state"]
    layout = h5py.VirtualLayout((ROWS, 2), np.float32)
    layout[:] = h5py.VirtualSource(str(other), "state", (ROWS, 2))
    file.create_virtual_dataset("state", layout)


def virtual_over_a_pipe(file: h5py.File, other: Path) -> None:
    os.mkfifo(other.with_suffix(".pipe"))
    del file["state"]
    unlimited = h5py.h5s.UNLIMITED
    spaces = []
    for _ in range(2):
        spaces.append(h5py.h5s.create_simple((ROWS, 2), (unlimited, 2)))
        spaces[-1].select_hyperslab((0, 0), (unlimited, 1), (1, 1), (1, 2))
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_virtual(spaces[0], bytes(other.with_suffix(".pipe")), b"state", spaces[1])
    h5py.h5d.create(file.id, b"state", h5py.h5t.IEEE_F32LE, spaces[0], dcpl=layout)


def unknown_filter(file: h5py.File, other: Path) -> None:
    del file["state"]
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk((ROWS, 2))
    layout.set_filter(32015, h5py.h5z.FLAG_OPTIONAL)
    space = h5py.h5s.create_simple((ROWS, 2))
    h5py.h5d.create(file.id, b"state", h5py.h5t.IEEE_F32LE, space, dcpl=layout)


def recreate(**options: Any) -> Callable[[h5py.File, Path], None]:
    def change(file: h5py.File, _: Path) -> None:
        del file["state"]
        file.create_dataset("state", **options)

    return change


def shape_bomb(file: h5py.File, other: Path) -> None:
    del file["pixels"]
    file.create_dataset("pixels", (10**9, 64, 64, 3), np.uint8, chunks=(64, 64, 64, 3))


def chunk_bomb(file: h5py.File, other: Path) -> None:
    del file["pixels"]
    file.create_dataset(
        "pixels", (ROWS * 500, 64, 64, 3), np.uint8, chunks=(4500, 64, 64, 3), compression="gzip"
    )


def inflating_chunk(file: h5py.File, other: Path) -> None:
    del file["state"]
    state = file.create_dataset(
        "state", (ROWS, 2), np.float32, chunks=(ROWS, 2), compression="gzip"
    )
    state.id.write_direct_chunk((0, 0), zlib.compress(bytes(50_000_000)))


def packed_pixels(file: h5py.File, rows: int) -> h5py.Dataset:
    """The column of frames anew, as elast writes it."""
    del file["pixels"]
    chunks = (min(rows, 64), 64, 64, 3)
    return file.create_dataset(
        "pixels", (rows, 64, 64, 3), "u1", chunks=chunks, compression="gzip", fletcher32=True
    )


def checked(content: bytes) -> bytes:
    """A chunk's bytes and their checksum."""
    return content + _fletcher32(content).to_bytes(4, "little")


def decompression_bomb(file: h5py.File, other: Path) -> None:
    pixels = packed_pixels(file, 64 * 200)  # 157 MB from 160 kB
    packed = checked(zlib.compress(bytes(64 * 64 * 64 * 3)))
    for start in range(0, len(pixels), 64):
        pixels.id.write_direct_chunk((start, 0, 0, 0), packed)


def deflated_twice(file: h5py.File, other: Path) -> None:
    del file["pixels"]
    pipeline = h5p.create(h5p.DATASET_CREATE)
    pipeline.set_chunk((ROWS, 64, 64, 3))
    for _ in range(2):
        pipeline.set_deflate(9)
    pipeline.set_fletcher32()
    space = h5s.create_simple((ROWS, 64, 64, 3))
    pixels = h5d.create(file.id, b"pixels", h5t.NATIVE_UINT8, space, pipeline)
    content = zlib.compress(zlib.compress(bytes(ROWS * 64 * 64 * 3)))
    pixels.write_direct_chunk((0, 0, 0, 0), checked(content))


def chunks_across_rows(file: h5py.File, other: Path) -> None:
    del file["state"]
    file.create_dataset("state", (ROWS, 2), "f4", chunks=(ROWS, 1), fletcher32=True)
    file["state"][:] = 0


def unchecked_chunk(file: h5py.File, other: Path) -> None:
    pixels = packed_pixels(file, ROWS)
    pixels.id.write_direct_chunk((0, 0, 0, 0), zlib.compress(bytes(ROWS * 64 * 64 * 3)), 2)


HDF5: dict[str, tuple[Callable[[h5py.File, Path], None], str]] = {
    "an external link": (external_link, "state is a link"),
    "a soft link": (soft_link, "state is a link"),
    "a nested link": (nested_link, "state is not a column"),
    "a cycle": (cycle, "state is not a column"),
    "an extra group": (extra_group, "unknown column 'more'"),
    "external storage": (external_storage, "pixels is not stored in chunks"),
    "a virtual column": (virtual, "state is not stored in chunks"),
    "a virtual column over a pipe": (virtual_over_a_pipe, "state is not stored in chunks"),
    "an unknown filter": (unknown_filter, "0 of 1 chunks|other filters than elast's"),
    "variable-length rows": (
        recreate(shape=(ROWS,), dtype=h5py.vlen_dtype(np.float32), chunks=(ROWS,)),
        "state has type object",
    ),
    "variable-length strings": (
        recreate(shape=(ROWS,), dtype=h5py.string_dtype(), chunks=(ROWS,)),
        "state has type object",
    ),
    "compound rows": (
        recreate(shape=(ROWS,), dtype=np.dtype([("x", "<f4"), ("y", "<f4")]), chunks=(ROWS,)),
        "state has type",
    ),
    "references": (recreate(shape=(ROWS,), dtype=h5py.ref_dtype, chunks=(ROWS,)), "state has type"),
    "an enumeration": (
        recreate(shape=(ROWS, 2), dtype=h5py.enum_dtype({"A": 1}, "i4"), chunks=(ROWS, 2)),
        "state has type",
    ),
    "doubles": (recreate(shape=(ROWS, 2), dtype="<f8", chunks=(ROWS, 2)), "state has type float64"),
    "a scalar column": (recreate(data=np.float32(1)), "state"),
    "an empty column": (recreate(data=h5py.Empty("f4")), "state"),
    "a column without chunks": (recreate(data=np.zeros((ROWS, 2), "f4")), "not stored in chunks"),
    "no rows": (recreate(shape=(0, 2), maxshape=(None, 2), dtype="<f4", chunks=(1, 2)), "shape"),
    "too few dimensions": (recreate(data=np.zeros(ROWS, "f4"), chunks=(ROWS,)), "shape"),
    "10 TB in a kilobyte": (shape_bomb, "declares|chunks"),
    "a chunk of 55 MB": (chunk_bomb, "pixels has chunks of"),
    "a chunk that inflates": (inflating_chunk, "longer than its content"),
    "frames that are deflated twice": (deflated_twice, "other filters than elast's"),
    "chunks of parts of rows": (chunks_across_rows, "not of whole rows"),
    "a chunk without its checksum": (unchecked_chunk, "without its checksum"),
    "a decompression bomb": (decompression_bomb, "declares .* bytes and stores"),
}


@pytest.mark.parametrize("case", HDF5)
def test_a_hostile_dataset_is_refused(tmp_path: Path, case: str) -> None:
    change, message = HDF5[case]
    other = save(tmp_path / "other.h5", {"state": np.zeros((ROWS, 2), np.float32)})
    other.with_suffix(".raw").write_bytes(SECRET * 10_000)
    path = save(tmp_path / "data.h5", columns())
    with h5py.File(path, "r+", libver="latest") as file:
        change(file, other)
    refused(path, message)


SHORT: dict[str, bytes] = {
    "less than a checksum": b"abc",
    "fewer bytes than values": checked(zlib.compress(bytes(1000))),
    "more bytes than values": checked(zlib.compress(bytes(ROWS * 64 * 64 * 3 + 1))),
    "a stream that is cut off": checked(zlib.compress(bytes(ROWS * 64 * 64 * 3))[:-40]),
    "no stream": checked(b"0123456789"),
    "a wrong checksum": zlib.compress(bytes(ROWS * 64 * 64 * 3)) + b"abcd",
}


@pytest.mark.parametrize("case", SHORT)
def test_a_chunk_is_exactly_as_long_as_its_frames(tmp_path: Path, case: str) -> None:
    """HDF5 itself would hand out memory that nobody has written."""
    path = save(tmp_path / "data.h5", columns())
    with h5py.File(path, "r+") as file:
        packed_pixels(file, ROWS).id.write_direct_chunk((0, 0, 0, 0), SHORT[case])
    with pytest.raises(DataError, match=r"damaged|chunk"):
        Dataset.load(path).pixels[:]


@pytest.mark.parametrize("content", [b"abc", checked(b""), checked(b"0" * 7)])
@pytest.mark.parametrize("name", ["ep_len", "ep_offset", "ep_idx", "step_idx", "action", "state"])
def test_a_chunk_of_numbers_is_exactly_as_long_as_they_are(
    tmp_path: Path, name: str, content: bytes
) -> None:
    """With a checksum alone, HDF5 would read beyond the end of its memory."""
    path = save(tmp_path / "data.h5", columns())
    with h5py.File(path, "r+") as file:
        shape, kind = file[name].shape, file[name].dtype
        del file[name]
        column = file.create_dataset(name, shape, kind, chunks=shape, fletcher32=True)
        column.id.write_direct_chunk((0,) * len(shape), content)
    with pytest.raises(DataError, match="damaged"):
        Dataset.load(path)
