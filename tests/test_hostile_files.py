"""Files made to do harm: each is refused within bounds, naming what is wrong."""

from __future__ import annotations

import hashlib
import os
import resource
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from elast_cli.config import StrictModel, dump_yaml, parse_yaml, read_yaml, validate
from elast_cli.data.dataset import Dataset
from elast_cli.errors import ConfigError, DataError
from elast_cli.store.manifest import MANIFEST, MANIFEST_DIGEST, Recipe, Ref
from elast_cli.store.store import Store

SECRET = b"the other file's bytes"


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    """No hostile file may cost more than a second or 300 MB."""
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    yield
    assert time.monotonic() - begun < 1.5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000


# ---- YAML ---------------------------------------------------------------------------------------

YAML = {
    "a python tag": (b"a: !!python/object/apply:os.system ['touch owned']", "tags are not allowed"),
    "any tag": (b"a: !secret x", "tags are not allowed"),
    "a duplicate key": (b"a: 1\na: 2", 'line 2: found duplicate key "a"'),
    "an alias": (b"a: &x [1]\nb: *x", "line 1: anchors and aliases"),
    "a billion laughs": (b"a: &a [x]\nb: &b [*a,*a]\nc: [*b,*b]", "anchors and aliases"),
    "100k brackets": (b"[" * 100_000, "nested deeper than 32"),
    "100k braces": (b"{a: " * 100_000, "nested deeper than 32"),
    "100k dashes": (b"- " * 100_000, "nested deeper than 32"),
    "500k values": (b"a: [" + b"1," * 500_000 + b"]", "more than 20000 values"),
    "NaN": (b"a: {b: .nan}", r"a\.b: nan is not a finite number"),
    "infinity": (b"a: [1, -.inf]", r"a\[1\]: -inf is not a finite number"),
    "an overflowing number": (b"a: 1e999", "a: inf is not a finite number"),
    "a huge integer": (b"a: " + b"9" * 500_000, "integer string conversion"),
    "a long integer": (b"a: 0x" + b"f" * 300_000, "more than 64 bits"),
    "bad UTF-8": (b"a: \xff\xfe", r"not UTF-8 text \(byte 3\)"),
    "a NUL": (b"a: \x00", "unacceptable character"),
    "half a surrogate pair": (b'a: "\\ud800"', "a: not valid Unicode text"),
    "a date": (b"a: 2020-01-01", "not plain data"),
    "a key that is no string": (b"1: 2", "key 1 is not a string"),
    "two documents": (b"a: 1\n---\nb: 2", "line 2: but found another document"),
    "an unclosed list": (b"a: [", "line 1"),
    "too many bytes": (b"#" * (1 << 20) + b"\n", "larger than 1048576 bytes"),
}


@pytest.mark.parametrize("case", YAML)
def test_hostile_yaml_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = YAML[case]
    path = tmp_path / "config.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as caught:
        read_yaml(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


def test_a_folder_or_a_pipe_is_no_config(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ConfigError, match="not a regular file"):
            read_yaml(path)
    with pytest.raises(ConfigError, match="null"):
        read_yaml(tmp_path / "a\0b")


def test_a_hostile_value_is_shortened_to_one_line() -> None:
    class Config(StrictModel):
        count: int

    with pytest.raises(ConfigError) as caught:
        validate(Config, {"count": "line\n" * 10_000}, where="config.yaml")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


# ---- manifests ----------------------------------------------------------------------------------


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "home")


def publish(store: Store, kind: str, parents: dict[str, Ref]) -> Ref:
    made = Recipe(
        kind=kind,
        env="block-s",
        seed=0,
        preset="quick",
        config={},
        parents={role: store.digest(ref) for role, ref in parents.items()},
    )
    with store.begin(made, parents=parents) as run:
        (run.staging / "weights.bin").write_bytes(b"weights")
        return run.publish({})


def read(store: Store, ref: Ref) -> dict[str, Any]:
    return dict(parse_yaml((store.path(ref) / MANIFEST).read_bytes(), "manifest"))


def write(store: Store, ref: Ref, content: bytes) -> None:
    """Put a manifest in place, with a digest file that agrees."""
    digest = hashlib.sha256(content).hexdigest()
    (store.path(ref) / MANIFEST).write_bytes(content)
    (store.path(ref) / MANIFEST_DIGEST).write_text(f"{digest}  {MANIFEST}\n")


def rename_file(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.update(files={name: data["files"]["weights.bin"]})


def rename_parent(text: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["parents"]["dataset"].update(ref=text)


MANIFESTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "a path upwards": (rename_file("../../secret"), r"files\.\.\./\.\./secret"),
    "an absolute path": (rename_file("/etc/passwd"), "files"),
    "a NUL in a path": (rename_file("a\0b"), "files"),
    "a hidden file": (rename_file(".bashrc"), "files"),
    "a folder in a path": (rename_file("a/b"), "files"),
    "a line break in a path": (rename_file("weights.bin\n"), "files"),
    "a parent elsewhere": (rename_parent("../../etc/v1"), r"parents\.dataset\.ref"),
    "a negative size": (lambda d: d["files"]["weights.bin"].update(size=-1), "got -1"),
    "a wrong digest": (lambda d: d["files"]["weights.bin"].update(sha256="00"), "sha256"),
    "an unknown key": (lambda d: d.update(metric={}), "did you mean 'metrics'"),
    "a missing key": (lambda d: d.pop("files"), "files: required key is missing"),
    "a newer schema": (lambda d: d.update(schema_version=99), "pip install --upgrade elast"),
    "no schema": (lambda d: d.pop("schema_version"), "schema_version: expected 1"),
    "a schema in words": (lambda d: d.update(schema_version="one"), "schema_version"),
    "another version's": (lambda d: d.update(version=7), "manifest of block-s/encoder/v7"),
    "another recipe": (lambda d: d["recipe"].update(seed=9), "recipe_digest"),
    "other parents": (lambda d: d.update(parents={}), "parents differ"),
}


@pytest.mark.parametrize("case", MANIFESTS)
def test_a_hostile_manifest_is_refused(store: Store, case: str) -> None:
    change, message = MANIFESTS[case]
    ref = publish(store, "encoder", {"dataset": publish(store, "dataset", {})})
    data = read(store, ref)
    change(data)
    write(store, ref, dump_yaml(data).encode())
    for use in (store.manifest, store.verify, lambda ref: store.file(ref, "weights.bin")):
        with pytest.raises(DataError, match=message) as caught:
            use(ref)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("case", YAML)
def test_hostile_yaml_as_a_manifest_is_refused(store: Store, case: str) -> None:
    ref = publish(store, "dataset", {})
    write(store, ref, YAML[case][0])
    with pytest.raises(DataError):
        store.verify(ref)


def damage_manifest(folder: Path, other: Path) -> None:
    with open(folder / MANIFEST, "r+b") as file:
        file.write(b"F")


def remove_digest(folder: Path, other: Path) -> None:
    (folder / MANIFEST_DIGEST).unlink()


def link_manifest(folder: Path, other: Path) -> None:
    (folder / MANIFEST).rename(other.with_name("manifest"))
    (folder / MANIFEST).symlink_to(other.with_name("manifest"))


def link_member(folder: Path, other: Path) -> None:
    other.write_bytes(b"weights")  # even if the content is right
    (folder / "weights.bin").unlink()
    (folder / "weights.bin").symlink_to(other)


def pipe_member(folder: Path, other: Path) -> None:
    (folder / "weights.bin").unlink()
    os.mkfifo(folder / "weights.bin")


def folder_member(folder: Path, other: Path) -> None:
    (folder / "weights.bin").unlink()
    (folder / "weights.bin").mkdir()


def missing_member(folder: Path, other: Path) -> None:
    (folder / "weights.bin").unlink()


def extra_member(folder: Path, other: Path) -> None:
    (folder / "extra.bin").touch()


def short_member(folder: Path, other: Path) -> None:
    (folder / "weights.bin").write_bytes(b"weight")


def changed_member(folder: Path, other: Path) -> None:
    (folder / "weights.bin").write_bytes(b"Weights")


def link_folder(folder: Path, other: Path) -> None:
    folder.rename(other.with_name("folder"))
    folder.symlink_to(other.with_name("folder"))


FOLDERS: dict[Callable[[Path, Path], None], str] = {
    damage_manifest: "manifest.yaml does not match",
    remove_digest: r"incomplete.*manifest\.yaml\.sha256: no such file",
    link_manifest: "manifest.yaml is a symbolic link",
    link_folder: "folder is a symbolic link",
    link_member: "weights.bin is a symbolic link",
    pipe_member: "weights.bin",
    folder_member: "weights.bin",
    missing_member: "weights.bin is missing",
    extra_member: "'extra.bin' is not in its manifest",
    short_member: "weights.bin has 6 bytes, not 7",
    changed_member: "weights.bin was changed",
}


@pytest.mark.parametrize("harm", FOLDERS)
def test_a_changed_artifact_is_refused_naming_the_file(
    store: Store, tmp_path: Path, harm: Callable[[Path, Path], None]
) -> None:
    ref = publish(store, "dataset", {})
    store.verify(ref)
    harm(store.path(ref), tmp_path / "other")
    with pytest.raises(DataError, match=FOLDERS[harm]):
        store.verify(ref)


def test_a_cycle_of_parents_is_refused(store: Store) -> None:
    data = publish(store, "dataset", {})
    encoder = publish(store, "encoder", {"dataset": data})
    looped = read(store, data)
    looped["parents"] = {"encoder": {"ref": str(encoder), "digest": store.digest(encoder)}}
    looped["recipe"]["parents"] = {"encoder": store.digest(encoder)}
    looped["recipe_digest"] = Recipe.model_validate(looped["recipe"]).digest
    write(store, data, dump_yaml(looped).encode())
    # a true cycle of digests cannot be made, so its weakest link is what gets named
    for ref in (data, encoder):
        with pytest.raises(DataError, match=r"cycle|another one than it was made from"):
            store.verify(ref)
    itself = read(store, data)
    itself["parents"]["encoder"]["ref"] = str(data)
    write(store, data, dump_yaml(itself).encode())
    with pytest.raises(DataError, match="closes a cycle"):
        store.lineage(data)


# ---- HDF5 ---------------------------------------------------------------------------------------

LENGTHS = (3, 4, 2)
ROWS = sum(LENGTHS)


def columns() -> dict[str, Any]:
    """A valid dataset of three episodes."""
    length = np.array(LENGTHS, np.int32)
    offset = np.cumsum(length, dtype=np.int64) - length
    action = np.zeros((ROWS, 2), np.float32)
    action[offset + length - 1] = np.nan
    return {
        "pixels": np.zeros((ROWS, 64, 64, 3), np.uint8),
        "action": action,
        "state": np.zeros((ROWS, 2), np.float32),
        "step_idx": (np.arange(ROWS) - np.repeat(offset, length)).astype(np.int32),
        "ep_idx": np.repeat(np.arange(3, dtype=np.int32), length),
        "ep_len": length,
        "ep_offset": offset,
    }


def save(path: Path, data: dict[str, Any]) -> Path:
    with h5py.File(path, "w", libver="latest") as file:
        for name, values in data.items():
            file.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
    return path


def refused(path: Path, message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        _ = Dataset.load(path).pixels[:]
    assert "\n" not in str(caught.value)
    assert SECRET.decode() not in str(caught.value)


def test_the_dataset_that_the_hostile_ones_are_made_from_is_valid(tmp_path: Path) -> None:
    assert Dataset.load(save(tmp_path / "data.h5", columns())).episodes == 3


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


def decompression_bomb(file: h5py.File, other: Path) -> None:
    del file["pixels"]
    rows = 64 * 200  # 157 MB from 160 kB
    pixels = file.create_dataset(
        "pixels", (rows, 64, 64, 3), np.uint8, chunks=(64, 64, 64, 3), compression="gzip"
    )
    packed = zlib.compress(bytes(64 * 64 * 64 * 3))
    for start in range(0, rows, 64):
        pixels.id.write_direct_chunk((start, 0, 0, 0), packed)


HDF5: dict[str, tuple[Callable[[h5py.File, Path], None], str]] = {
    "an external link": (external_link, "state is a link"),
    "a soft link": (soft_link, "state is a link"),
    "a nested link": (nested_link, "state is not a column"),
    "a cycle": (cycle, "state is not a column"),
    "an extra group": (extra_group, "unknown column 'more'"),
    "external storage": (external_storage, "pixels is not stored in chunks"),
    "a virtual column": (virtual, "state is not stored in chunks"),
    "a virtual column over a pipe": (virtual_over_a_pipe, "state is not stored in chunks"),
    "an unknown filter": (unknown_filter, "unknown filters"),
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


def put(name: str, where: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        data[name][where] = value

    return change


def cut(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.update({name: data[name][:-1]})


INCONSISTENT: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "NaN in an action": (put("action", 4, np.nan), "episode 1 step 1: an action before the last"),
    "infinity in an action": (put("action", (7, 0), np.inf), "episode 2 step 0: an action before"),
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
