"""The store: idempotence, versions, locks, and where artifacts are."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

from elast_cli.errors import BusyError, MissingInputError
from elast_cli.store.manifest import MANIFEST, Ref
from elast_cli.store.store import Store
from tests.toys.artifacts import child_of, publish, recipe
from tests.toys.stage import python


def test_datasets_and_artifacts_have_their_own_folders(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    assert store.path(data) == store.home / "data/block-s/dataset/v1"
    assert store.path(encoder) == store.home / "artifacts/block-s/encoder/v1"
    assert store.refs() == [data, encoder]
    assert store.refs(kind="encoder") == [encoder]
    assert store.refs(env="other") == []


def test_the_store_is_where_the_variable_says_or_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ELAST_HOME", raising=False)
    assert Store.default().home == tmp_path
    monkeypatch.setenv("ELAST_HOME", "elsewhere")
    assert Store.default().home == tmp_path / "elsewhere"
    assert Store.default().refs() == []
    assert not list(tmp_path.iterdir())


def test_the_store_knows_neither_torch_nor_hdf5() -> None:
    script = "import sys, elast_cli.store; print({'torch', 'h5py'} & set(sys.modules))"
    assert python(script) == "set()"


def test_a_published_artifact_has_what_was_staged_and_nothing_remains_of_the_run(
    store: Store,
) -> None:
    ref = publish(store, recipe())
    manifest = store.manifest(ref)
    assert store.file(ref, "content.bin").read_bytes() == b"content"
    assert manifest.metrics == {"loss": 0.5, "missing": None}
    assert manifest.recipe == recipe()
    assert {"elast", "python", "platform", "created", "libraries"} <= set(manifest.provenance)
    for left in (".runs", ".staging"):
        assert not list((store.home / "data" / left).iterdir())


def test_the_same_recipe_is_made_once_unless_forced(store: Store) -> None:
    first = publish(store, recipe())
    assert publish(store, recipe()) == first
    assert publish(store, recipe(seed=1)).version == 2
    forced = publish(store, recipe(), force=True)
    assert forced.version == 3
    assert store.find(recipe()) == forced


def test_a_removed_version_number_is_never_used_again(store: Store) -> None:
    publish(store, recipe())
    second = publish(store, recipe(seed=1))
    shutil.rmtree(store.path(second))
    assert publish(store, recipe(seed=2)).version == 3


@pytest.mark.parametrize("note", [b"", b"two", b"\xff\xfe", b"9" * 5000, b"-3", b"1\n2"])
def test_a_damaged_note_of_the_highest_version_is_made_anew(store: Store, note: bytes) -> None:
    first = publish(store, recipe())
    mark = store.path(first).parent / ".highest"
    mark.write_bytes(note)
    assert publish(store, recipe(seed=1)).version == 2
    assert mark.read_bytes() == b"2\n"


def test_a_name_that_is_taken_by_others_is_passed_over(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = store.home / "data/block-s/dataset"
    (folder / "v1").mkdir(parents=True)
    (folder / "v1" / "stranger").touch()
    monkeypatch.setattr("elast_cli.store.run.next_version", lambda _: 1)
    assert publish(store, recipe()).version == 2


def test_the_latest_fitting_artifact_is_chosen_and_a_damaged_one_never(store: Store) -> None:
    refs = [publish(store, recipe(seed=seed)) for seed in range(3)]
    even = store.latest("block-s", "dataset", where=lambda found: found.recipe.seed % 2 == 0)
    assert even == refs[2]
    (store.path(refs[2]) / MANIFEST).write_text("changed")
    assert store.latest("block-s", "dataset", where=lambda _: True) == refs[1]
    assert store.latest("block-s", "dataset", where=lambda _: False) is None
    assert store.find(recipe(seed=2)) is None


def test_a_missing_artifact_names_what_there_is_or_what_makes_it(store: Store) -> None:
    with pytest.raises(MissingInputError, match="run: elast train-encoder --env block-s"):
        store.manifest(Ref("block-s", "encoder", 1))
    publish(store, recipe())
    with pytest.raises(MissingInputError, match="there is block-s/dataset/v1"):
        store.manifest(Ref("block-s", "dataset", 7))


def test_only_plain_files_and_finite_metrics_can_be_published(store: Store) -> None:
    with store.begin(recipe(), parents={}) as run:
        with pytest.raises(ValueError, match="JSON"):
            run.publish({"loss": float("nan")})
        (run.staging / "folder").mkdir()
        with pytest.raises(ValueError, match="regular file"):
            run.publish({})
        (run.staging / "folder").rmdir()
        (run.staging / "link").symlink_to("/etc/hostname")
        with pytest.raises(ValueError, match="symbolic link"):
            run.publish({})
    assert store.refs() == []


def test_a_second_run_of_a_recipe_waits_says_so_and_finds_the_first_ones_result(
    store: Store,
) -> None:
    said = threading.Event()
    results: list[Ref] = []

    def second() -> None:
        results.append(publish(store, recipe(), on_wait=lambda _: said.set()))

    thread = threading.Thread(target=second)
    with store.begin(recipe(), parents={}) as run:
        thread.start()
        assert said.wait(20)
        with pytest.raises(BusyError, match="another process is making this block-s/dataset"):
            publish(store, recipe(), wait=False)
        assert publish(store, recipe(seed=1), wait=False).version == 1
        first = run.publish({})
    thread.join(20)
    assert results == [first]
