"""Bundles: whole methods in one file, the same bytes every time."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from elast_cli.errors import DataError
from elast_cli.store import origins
from elast_cli.store.bundle import INDEX, write_bundle
from elast_cli.store.manifest import Parent, Ref
from elast_cli.store.run import HIGHEST
from elast_cli.store.store import Store
from elast_cli.store.unbundle import unpack
from tests.toys.artifacts import child_of, publish, recipe
from tests.toys.bundles import bundled, chain, contents, members


@pytest.fixture
def other(tmp_path: Path) -> Store:
    return Store(tmp_path / "other")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "toy.zip"


def test_a_bundle_has_the_files_of_parts_and_the_manifests_of_their_lineage(
    store: Store, path: Path
) -> None:
    bundled(store, path)
    assert [info.filename for info, _ in members(path)] == [
        INDEX,
        "block-s/dataset/v1/manifest.yaml",
        "block-s/dataset/v1/manifest.yaml.sha256",
        "block-s/encoder/v1/manifest.yaml",
        "block-s/encoder/v1/manifest.yaml.sha256",
        "block-s/encoder/v1/content.bin",
    ]


def test_bundling_what_was_unbundled_gives_the_same_bytes(
    store: Store, other: Store, path: Path
) -> None:
    found = bundled(store, path)
    assert unpack(path, other) == found
    write_bundle(other, found, path.with_name("again.zip"))
    assert path.read_bytes() == path.with_name("again.zip").read_bytes()
    shutil.rmtree(store.home / "data")  # without its manifest the origin is not known
    write_bundle(store, found, path)
    assert path.read_bytes() != path.with_name("again.zip").read_bytes()


def test_unbundling_gives_the_same_artifact_under_the_same_ref(
    store: Store, other: Store, path: Path
) -> None:
    bundled(store, path)
    unpack(path, other)
    ref = Ref("block-s", "encoder", 1)
    assert other.refs() == [ref]
    for file in store.path(ref).iterdir():
        assert (other.path(ref) / file.name).read_bytes() == file.read_bytes()
    assert (other.path(ref).parent / HIGHEST).read_text() == "1\n"
    assert publish(other, recipe("encoder", seed=1)).version == 2


def test_the_origin_of_a_part_is_kept_and_a_damaged_one_is_lost(
    store: Store, other: Store, path: Path
) -> None:
    bundled(store, path)
    unpack(path, other)
    data = Ref("block-s", "dataset", 1)
    parent = Parent(ref=str(data), digest=store.digest(data))
    found = origins.find(other, parent)
    assert found is not None
    assert found[0] == data
    assert origins.find(other, parent.model_copy(update={"digest": "0" * 64})) is None
    encoder = Ref("block-s", "encoder", 1)
    assert other.verify(encoder).ref == encoder
    (found[1] / "manifest.yaml").write_text("damaged")
    assert origins.find(other, parent) is None
    with pytest.raises(DataError, match="its dataset block-s/dataset/v1 no longer exists"):
        other.verify(encoder)
    assert other.gc() == []


def test_unbundling_twice_does_no_work(store: Store, other: Store, path: Path) -> None:
    bundled(store, path)
    unpack(path, other)
    before = {file: file.stat().st_mtime_ns for file in other.home.rglob("*") if file.is_file()}
    unpack(path, other)
    assert before == {file: file.stat().st_mtime_ns for file in before}
    assert not list((other.home / "artifacts/.staging").iterdir())


@pytest.mark.parametrize("kind", ["dataset", "encoder"])
def test_another_artifact_of_that_name_is_never_replaced(
    store: Store, other: Store, path: Path, kind: str
) -> None:
    bundled(store, path)
    publish(other, recipe(kind, seed=7))
    before = sorted(other.home.rglob("*"))
    with pytest.raises(DataError, match=f"has another block-s/{kind}/v1.*elast unbundle"):
        unpack(path, other)
    assert sorted(other.home.rglob("*")) == before


def test_a_part_whose_file_was_changed_is_not_bundled(store: Store, path: Path) -> None:
    _, encoder = chain(store)
    (store.path(encoder) / "content.bin").write_bytes(b"Content")
    with pytest.raises(DataError, match=r"content\.bin was changed"):
        write_bundle(store, contents(encoder), path)
    assert not path.exists()


def test_a_lost_parent_is_left_out(store: Store, other: Store, path: Path) -> None:
    encoder = child_of(store, publish(store, recipe()))
    shutil.rmtree(store.home / "data")
    found = contents(encoder)
    write_bundle(store, found, path)
    assert not any("dataset" in info.filename for info, _ in members(path))
    assert unpack(path, other) == found
