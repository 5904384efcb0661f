"""Manifests and folders made to do harm: refused within bounds, naming what is wrong."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from elast_cli.config import dump_yaml
from elast_cli.errors import DataError
from elast_cli.store.manifest import MANIFEST, MANIFEST_DIGEST, Recipe
from elast_cli.store.store import Store
from tests.toys.artifacts import child_of, publish, put_manifest, read_manifest, recipe
from tests.toys.hostile import YAML, bounded

pytestmark = pytest.mark.timeout(30)


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with bounded():
        yield


def rename_file(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.update(files={name: data["files"]["content.bin"]})


def rename_parent(text: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["parents"]["dataset"].update(ref=text)


MANIFESTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "a path upwards": (rename_file("../../secret"), r"files\.\.\./\.\./secret"),
    "an absolute path": (rename_file("/etc/passwd"), "files"),
    "a NUL in a path": (rename_file("a\0b"), "files"),
    "a hidden file": (rename_file(".bashrc"), "files"),
    "a folder in a path": (rename_file("a/b"), "files"),
    "a line break in a path": (rename_file("content.bin\n"), "files"),
    "a parent elsewhere": (rename_parent("../../etc/v1"), r"parents\.dataset\.ref"),
    "a negative size": (lambda d: d["files"]["content.bin"].update(size=-1), "got -1"),
    "a wrong digest": (lambda d: d["files"]["content.bin"].update(sha256="00"), "sha256"),
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
    ref = child_of(store, publish(store, recipe()))
    data = read_manifest(store, ref)
    change(data)
    put_manifest(store, ref, dump_yaml(data).encode())
    for use in (store.manifest, store.verify, lambda ref: store.file(ref, "content.bin")):
        with pytest.raises(DataError, match=message) as caught:
            use(ref)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("case", YAML)
def test_hostile_yaml_as_a_manifest_is_refused(store: Store, case: str) -> None:
    ref = publish(store, recipe())
    put_manifest(store, ref, YAML[case][0])
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
    other.write_bytes(b"content")  # even if the content is right
    (folder / "content.bin").unlink()
    (folder / "content.bin").symlink_to(other)


def pipe_member(folder: Path, other: Path) -> None:
    (folder / "content.bin").unlink()
    os.mkfifo(folder / "content.bin")


def folder_member(folder: Path, other: Path) -> None:
    (folder / "content.bin").unlink()
    (folder / "content.bin").mkdir()


def missing_member(folder: Path, other: Path) -> None:
    (folder / "content.bin").unlink()


def extra_member(folder: Path, other: Path) -> None:
    (folder / "extra.bin").touch()


def short_member(folder: Path, other: Path) -> None:
    (folder / "content.bin").write_bytes(b"conten")


def changed_member(folder: Path, other: Path) -> None:
    (folder / "content.bin").write_bytes(b"Content")


def link_folder(folder: Path, other: Path) -> None:
    folder.rename(other.with_name("folder"))
    folder.symlink_to(other.with_name("folder"))


FOLDERS: dict[Callable[[Path, Path], None], str] = {
    damage_manifest: "manifest.yaml does not match",
    remove_digest: r"incomplete.*manifest\.yaml\.sha256: no such file",
    link_manifest: "manifest.yaml is a symbolic link",
    link_folder: "folder is a symbolic link",
    link_member: "content.bin is a symbolic link",
    pipe_member: "content.bin",
    folder_member: "content.bin",
    missing_member: "content.bin is missing",
    extra_member: "'extra.bin' is not in its manifest",
    short_member: "content.bin has 6 bytes, not 7",
    changed_member: "content.bin was changed",
}


@pytest.mark.parametrize("harm", FOLDERS)
def test_a_changed_artifact_is_refused_naming_the_file(
    store: Store, tmp_path: Path, harm: Callable[[Path, Path], None]
) -> None:
    ref = publish(store, recipe())
    store.verify(ref)
    harm(store.path(ref), tmp_path / "other")
    with pytest.raises(DataError, match=FOLDERS[harm]):
        store.verify(ref)


def test_a_cycle_of_parents_is_refused(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    looped = read_manifest(store, data)
    looped["parents"] = {"encoder": {"ref": str(encoder), "digest": store.digest(encoder)}}
    looped["recipe"]["parents"] = {"encoder": store.digest(encoder)}
    looped["recipe_digest"] = Recipe.model_validate(looped["recipe"]).digest
    put_manifest(store, data, dump_yaml(looped).encode())
    # a true cycle of digests cannot be made, so its weakest link is what gets named
    for ref in (data, encoder):
        with pytest.raises(DataError, match=r"cycle|not the one that it was made from"):
            store.verify(ref)
    itself = read_manifest(store, data)
    itself["parents"]["encoder"]["ref"] = str(data)
    put_manifest(store, data, dump_yaml(itself).encode())
    with pytest.raises(DataError, match="closes a cycle"):
        store.lineage(data)
