"""Hostile and ordinary file systems: links, other disks, no locks, read-only stores, odd files."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import pytest
from filelock import FileLock

from elast_cli import files
from elast_cli.errors import DataError, StorageError
from elast_cli.store.manifest import MANIFEST, Recipe, Ref
from elast_cli.store.store import Store
from tests.toys import artifacts

RECIPE = Recipe(kind="dataset", env="block-s", seed=0, preset="quick", config={})


def publish(store: Store, recipe: Recipe = RECIPE) -> Ref:
    return artifacts.publish(store, recipe)


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder that is not elast's, with a file in it."""
    folder = tmp_path / "elsewhere"
    (folder / "photos").mkdir(parents=True)
    (folder / "photos" / "one.jpg").write_bytes(b"x")
    return folder


@pytest.mark.parametrize("name", [".runs", ".staging", ".locks"])
def test_gc_touches_nothing_behind_a_link(store: Store, elsewhere: Path, name: str) -> None:
    root = store.root("dataset")
    root.mkdir(parents=True)
    (root / name).symlink_to(elsewhere)
    with pytest.raises(StorageError, match=f"{name} is a symbolic link"):
        store.gc()
    assert (elsewhere / "photos" / "one.jpg").exists()


def test_gc_passes_over_what_elast_did_not_make(store: Store, elsewhere: Path) -> None:
    root = store.root("dataset")
    (root / ".runs").mkdir(parents=True)
    (root / ".staging").mkdir()
    (root / ".runs" / ".DS_Store").write_bytes(b"x")
    (root / ".staging" / "notes").mkdir()
    digest = RECIPE.digest
    (root / ".runs" / digest).symlink_to(elsewhere)
    (root / ".staging" / f"{digest}.0").mkdir()
    (store.cache / f"{digest}.f32" / "notes").mkdir(parents=True)
    removed = {path.name for path in store.gc()}
    assert removed == {digest, f"{digest}.0"}
    assert (elsewhere / "photos" / "one.jpg").exists()
    assert (root / ".runs" / ".DS_Store").exists()
    assert (root / ".staging" / "notes").exists()
    assert (store.cache / f"{digest}.f32" / "notes").exists()


def test_a_run_writes_nothing_behind_a_link(store: Store, elsewhere: Path) -> None:
    runs = store.root("dataset") / ".runs"
    runs.mkdir(parents=True)
    (runs / RECIPE.digest).symlink_to(elsewhere)
    with pytest.raises(StorageError, match="is a symbolic link"):
        publish(store)
    assert [path.name for path in elsewhere.iterdir()] == ["photos"]
    assert store.refs() == []


def test_an_artifacts_folder_on_another_disk_burns_no_version(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = Path("/dev/shm")
    if not other.is_dir() or other.stat().st_dev == store.home.parent.stat().st_dev:
        pytest.skip("no second file system here")
    folder = other / f"elast-test-{os.getpid()}"
    folder.mkdir()
    try:
        store.root("dataset").mkdir(parents=True)
        (store.root("dataset") / "block-s").symlink_to(folder)
        for _ in range(2):
            with pytest.raises(StorageError, match="another file system"):
                publish(store)
        assert not list(folder.glob("dataset/*"))
    finally:
        shutil.rmtree(folder)


def test_a_published_artifact_is_found_in_a_store_that_cannot_be_written(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    ref = publish(store)

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    for name in ("mkdir", "rename", "unlink", "replace"):
        monkeypatch.setattr(os, name, refused)
    monkeypatch.setattr(Path, "mkdir", refused)
    monkeypatch.setattr(FileLock, "acquire", refused)
    assert publish(store) == ref


@pytest.mark.parametrize(
    "number", [errno.ESTALE, errno.EREMOTEIO, errno.ETIMEDOUT, errno.ENAMETOOLONG, errno.ELOOP]
)
def test_any_error_of_the_disk_is_one_line(store: Store, number: int) -> None:
    with pytest.raises(StorageError) as caught, store.begin(RECIPE, parents={}):
        raise OSError(number, os.strerror(number))
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 74


def test_an_error_while_a_manifest_is_read_is_not_taken_for_damage(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(store)
    real = files.open_regular

    def failing(path: Path) -> object:
        if path.name == MANIFEST:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(path)

    monkeypatch.setattr(files, "open_regular", failing)
    with pytest.raises(StorageError, match="Input/output error"):
        publish(store)
    monkeypatch.undo()
    assert [ref.version for ref in store.refs()] == [1]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_without_file_locks_an_exclusive_file_stands_for_one(
    store: Store, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def no_locks(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(FileLock, "acquire", no_locks)
    said: list[str] = []
    with store.begin(RECIPE, parents={}, on_wait=said.append) as run:
        (run.staging / "content.bin").write_bytes(b"content")
        assert list((store.root("dataset") / ".locks").glob("*.exclusive"))
        run.publish({})
    assert "has no file locks" in said[0]
    assert not list((store.root("dataset") / ".locks").glob("*.exclusive"))


@pytest.mark.parametrize("make", ["fifo", "folder", "link"])
def test_an_odd_file_for_a_lock_is_one_line(store: Store, elsewhere: Path, make: str) -> None:
    path = store.root("dataset") / ".locks" / f"{RECIPE.digest}.lock"
    path.parent.mkdir(parents=True)
    if make == "fifo":
        os.mkfifo(path)
    elif make == "folder":
        path.mkdir()
    else:
        path.symlink_to(elsewhere / "photos" / "one.jpg")
    with pytest.raises(StorageError, match=r"\.lock: not a regular file"):
        publish(store)


def test_an_odd_note_of_the_highest_version_is_one_line(store: Store) -> None:
    folder = store.root("dataset") / "block-s" / "dataset"
    folder.mkdir(parents=True)
    os.mkfifo(folder / ".highest")
    with pytest.raises(StorageError, match=r"\.highest: not a regular file"):
        publish(store)
    (folder / ".highest").unlink()
    (folder / ".highest").write_text("999999999")
    with pytest.raises(StorageError, match="no version after 999999999"):
        publish(store)
    assert store.refs() == []


def test_folders_on_the_way_to_an_artifact_are_synced_before_its_ref_is_known(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    real = os.open

    def noting(path: object, flags: int, *rest: object, **more: object) -> int:
        if flags & os.O_DIRECTORY:
            synced.append(str(path))
        return real(path, flags, *rest, **more)  # type: ignore[arg-type]  # passed through

    monkeypatch.setattr(os, "open", noting)
    ref = publish(store)
    folder = store.path(ref)
    missing = {str(above) for above in folder.parents if above.is_relative_to(store.home.parent)}
    assert missing - {str(store.home.parent.parent)} <= set(synced)


def test_a_store_whose_folder_is_no_folder_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "home").write_text("a file")
    with pytest.raises((StorageError, DataError)):
        publish(Store(tmp_path / "home"))
