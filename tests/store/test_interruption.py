"""Stages that are killed, disks that fill up: nothing is lost, nothing is published half."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from elast_cli.data.layout import column_digests
from elast_cli.errors import StorageError
from elast_cli.store.store import Store
from tests.toys.artifacts import interrupt, publish, recipe
from tests.toys.stage import EPISODES, collect, python


def test_an_interrupted_run_publishes_nothing_and_keeps_its_work(store: Store) -> None:
    interrupt(store, recipe())
    assert store.refs() == []
    assert not list((store.home / "data/.staging").iterdir())
    with store.begin(recipe(), parents={}) as run:
        assert (run.work / "shard").read_text() == "done"
        run.fresh()
        assert not list(run.work.iterdir())


def test_gc_removes_what_was_left_but_not_a_run_in_progress(store: Store) -> None:
    for seed in range(2):
        interrupt(store, recipe(seed=seed))
    with store.begin(recipe(), parents={}) as run:
        removed = store.gc()
        assert (run.work / "shard").exists()
        assert run.staging.exists()
    assert [path.name for path in removed] == [recipe(seed=1).digest]


def test_a_full_disk_is_one_line_and_leaves_nothing(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left on device") as caught:
        publish(store, recipe())
    assert "\n" not in str(caught.value)
    assert store.refs() == []
    assert not list((store.home / "data").glob(".staging/*"))


def test_a_disk_that_fills_up_under_a_dataset_is_a_storage_error(tmp_path: Path) -> None:
    script = f"""
import resource
from pathlib import Path
from tests.toys import stage
from elast_cli.errors import StorageError
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    stage.collect(stage.Store(Path({str(tmp_path)!r})))
except StorageError as reason:
    print("one line:", str(reason).count("\\n"))
"""
    assert python(script) == "one line: 0"
    assert Store(tmp_path).refs() == []


def test_a_kill_at_any_point_loses_nothing_and_publishes_nothing_half(tmp_path: Path) -> None:
    reference, made = collect(Store(tmp_path / "reference"))
    assert made == list(range(EPISODES))
    expected = column_digests(Store(tmp_path / "reference").file(reference, "episodes.h5"))

    script = f"""
from pathlib import Path
from tests.toys import stage
print(stage.collect_killed_at_every_point(Path({str(tmp_path)!r})))
"""
    points = int(python(script))
    assert points > 30
    for point in range(points):
        store = Store(tmp_path / str(point))
        published = store.refs()
        for ref in published:
            store.verify(ref)
        finished = list((store.home / "data/.runs").glob("*/episodes-*.h5"))
        ref, made = collect(store)
        assert len(made) == (0 if published else EPISODES - len(finished))
        assert column_digests(store.file(ref, "episodes.h5")) == expected
        assert store.verify(ref)
        assert not list((store.home / "data/.staging").iterdir())
        left = {path.name.partition(".")[0] for path in store.gc()}
        assert left <= {"", recipe().digest}  # killed after publication, or while it was noted
        assert store.gc() == []
