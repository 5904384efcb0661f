"""The store: idempotence, versions, locks, lineage, verification, and a kill at every point."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.config import dump_yaml, parse_yaml
from elast_cli.data.dataset import Episode
from elast_cli.data.layout import column_digests
from elast_cli.data.shards import compact, shard_path, write_shard
from elast_cli.errors import BusyError, DataError, MissingInputError, StorageError, UsageError
from elast_cli.stages.inspect import description
from elast_cli.store.manifest import MANIFEST, MANIFEST_DIGEST, Recipe, Ref
from elast_cli.store.store import Store

EPISODES = 2


def recipe(kind: str = "dataset", **changes: object) -> Recipe:
    basic = {"kind": kind, "env": "block-s", "seed": 0, "preset": "quick", "config": {}}
    return Recipe.model_validate(basic | changes)


def publish(
    store: Store, what: Recipe, parents: dict[str, Ref] | None = None, **options: Any
) -> Ref:
    with store.begin(what, parents=parents or {}, **options) as run:
        if run.published:
            return run.published
        (run.staging / "content.bin").write_bytes(b"content")
        return run.publish({"loss": 0.5, "missing": None})


def interrupt(store: Store, what: Recipe) -> None:
    with suppress(KeyboardInterrupt), store.begin(what, parents={}) as run:
        (run.work / "shard").write_text("done")
        (run.staging / "half").write_text("half")
        raise KeyboardInterrupt


def child_of(store: Store, parent: Ref, kind: str = "encoder") -> Ref:
    made = recipe(kind, parents={parent.kind: store.digest(parent)})
    return publish(store, made, {parent.kind: parent})


def forge(store: Store, ref: Ref, change: Callable[[dict[str, Any]], None]) -> None:
    """Rewrite a manifest, with a digest file that agrees."""
    folder = store.path(ref)
    data: dict[str, Any] = dict(parse_yaml((folder / MANIFEST).read_bytes(), "manifest"))
    change(data)
    content = dump_yaml(data).encode()
    (folder / MANIFEST).write_bytes(content)
    (folder / MANIFEST_DIGEST).write_text(f"{hashlib.sha256(content).hexdigest()}  {MANIFEST}\n")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path)


def test_a_ref_reads_as_it_is_written() -> None:
    assert Ref.parse("block-s/encoder/v12") == Ref("block-s", "encoder", 12)
    assert str(Ref("block-s", "encoder", 12)) == "block-s/encoder/v12"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "block-s",
        "block-s/encoder/2",
        "block-s/encoder/v0",
        "../encoder/v1",
        "a/b/v1/",
        "a/b/v\uff11",
        "a/b/v1\n",
    ],
)
def test_a_wrong_ref_is_refused_with_its_form(text: str) -> None:
    with pytest.raises(UsageError, match="block-s/encoder/v2"):
        Ref.parse(text)


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
    assert _python(script) == "set()"


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


def test_sha256sum_accepts_the_digest_file(store: Store) -> None:
    folder = store.path(publish(store, recipe()))
    subprocess.run(["sha256sum", "--check", "--strict", MANIFEST_DIGEST], cwd=folder, check=True)


def test_the_same_recipe_is_made_once_unless_forced(store: Store) -> None:
    first = publish(store, recipe())
    assert publish(store, recipe()) == first
    assert publish(store, recipe(seed=1)).version == 2
    forced = publish(store, recipe(), force=True)
    assert forced.version == 3
    assert store.find(recipe()) == forced


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"config": {"n": 2}},
        {"preset": "paper"},
        {"device": "cuda"},
        {"threads": 2},
        {"algorithm_version": 2},
        {"render_backend": "egl"},
        {"parents": {"dataset": "0" * 64}},
    ],
)
def test_whatever_determines_the_content_changes_the_recipe_digest(change: dict[str, Any]) -> None:
    assert recipe(**change).digest != recipe().digest


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
    monkeypatch.setattr("elast_cli.store.run._next_version", lambda _: 1)
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


def test_an_interrupted_run_publishes_nothing_and_keeps_its_work(store: Store) -> None:
    interrupt(store, recipe())
    assert store.refs() == []
    assert not list((store.home / "data/.staging").iterdir())
    with store.begin(recipe(), parents={}) as run:
        assert (run.work / "shard").read_text() == "done"
        run.fresh()
        assert not list(run.work.iterdir())


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


def test_gc_empties_the_cache_and_leaves_what_is_not_of_it(store: Store, tmp_path: Path) -> None:
    store.cache.mkdir(parents=True)
    entries = [store.cache / f"{'0' * 64}.f32", store.cache / f".{'1' * 64}.f32.123"]
    others = [store.cache / "notes.txt", store.cache / "0123.f32"]
    for path in (*entries, *others):
        path.touch()
    assert store.gc() == sorted(entries)
    assert sorted(store.cache.iterdir()) == sorted(others)
    store.cache.rename(tmp_path / "elsewhere")
    store.cache.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StorageError, match="symbolic link"):
        store.gc()


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
from tests.store import test_store
from elast_cli.errors import StorageError
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    test_store.collect(test_store.Store(Path({str(tmp_path)!r})))
except StorageError as reason:
    print("one line:", str(reason).count("\\n"))
"""
    assert _python(script) == "one line: 0"
    assert Store(tmp_path).refs() == []


def test_lineage_leads_back_to_the_dataset_and_verifies(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    policy = publish(
        store,
        recipe("policy", parents={"dataset": store.digest(data), "encoder": store.digest(encoder)}),
        {"dataset": data, "encoder": encoder},
    )
    root = store.lineage(policy)
    assert (root.ref, root.role) == (policy, "")
    assert {node.role: node.ref for node in root.parents} == {"dataset": data, "encoder": encoder}
    assert store.verify(policy).ref == policy
    with open(store.path(data) / "content.bin", "r+b") as file:
        file.write(b"C")
    with pytest.raises(DataError, match=r"block-s/dataset/v1: content\.bin was changed"):
        store.verify(policy)


def test_a_parent_that_changed_since_the_recipe_was_written_is_refused(store: Store) -> None:
    data = publish(store, recipe())
    stale = recipe("encoder", parents={"dataset": "0" * 64})
    with pytest.raises(DataError, match="parents"):
        publish(store, stale, {"dataset": data})


def test_a_replaced_or_removed_parent_breaks_the_lineage(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    forge(store, data, lambda found: found["metrics"].update(loss=0.0))
    with pytest.raises(DataError, match="another one than it was made from"):
        store.lineage(encoder)
    shutil.rmtree(store.path(data))
    with pytest.raises(DataError, match="no longer exists"):
        store.verify(encoder)
    (parent,) = store.lineage(encoder, allow_lost=True).parents
    assert (parent.ref, parent.lost) == (data, True)
    assert description(store, str(encoder))["digest"] == store.digest(encoder)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8"), max_size=20),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=10,
)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=8), json_values, max_size=4))
def test_yaml_gives_every_recipe_back_with_its_digest(config: dict[str, Any]) -> None:
    made = recipe(config=config)
    read = parse_yaml(dump_yaml(made.model_dump()).encode(), "recipe")
    assert Recipe.model_validate(read).digest == made.digest


# ---- killed at every point ----------------------------------------------------------------------


def episode(index: int) -> Episode:
    rng = np.random.default_rng(index)
    action = rng.uniform(-1, 1, (6, 2)).astype(np.float32)
    action[-1] = np.nan
    return Episode(
        pixels=rng.integers(0, 256, (6, 64, 64, 3), np.uint8),
        action=action,
        state=rng.normal(size=(6, 2)).astype(np.float32),
        context=None,
        seed_index=index,
    )


def collect(store: Store) -> tuple[Ref, list[int]]:
    """A stage as stages are written; also returns the episodes that it had to make."""
    made: list[int] = []
    with store.begin(recipe(), parents={}) as run:
        if run.published:
            return run.published, made
        shards = [shard_path(run.work, index) for index in range(EPISODES)]
        for index, path in enumerate(shards):
            if not path.exists():
                write_shard(path, [episode(index)])
                made.append(index)
        compact(shards, run.staging / "episodes.h5", attrs={"env": "block-s"})
        return run.publish({"episodes": EPISODES}), made


def collect_killed_at_every_point(home: Path) -> int:
    """Run `collect` in one child after another, the k-th killed at its k-th point: how many."""
    for point in range(1000):
        child = os.fork()
        if child == 0:
            _kill_at(point)
            collect(Store(home / str(point)))
            os._exit(0)
        if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != -signal.SIGKILL:
            return point
    raise AssertionError("no child reached its end")


def _kill_at(point: int) -> None:
    """Kill this process at its `point`-th moment just before or after a change on disk."""
    passed = 0

    def tick() -> None:
        nonlocal passed
        if passed == point:
            os.kill(os.getpid(), signal.SIGKILL)
        passed += 1

    def wrap(owner: Any, name: str) -> None:
        original = getattr(owner, name)

        def wrapped(*args: Any, **options: Any) -> Any:
            tick()
            result = original(*args, **options)
            tick()
            return result

        setattr(owner, name, wrapped)

    for owner, name in (
        (os, "fsync"),
        (os, "rename"),
        (os, "replace"),
        (os, "unlink"),
        (os, "mkdir"),
    ):
        wrap(owner, name)


def _python(script: str) -> str:
    path = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_kill_at_any_point_loses_nothing_and_publishes_nothing_half(tmp_path: Path) -> None:
    reference, made = collect(Store(tmp_path / "reference"))
    assert made == list(range(EPISODES))
    expected = column_digests(Store(tmp_path / "reference").file(reference, "episodes.h5"))

    script = f"""
from pathlib import Path
from tests.store import test_store
print(test_store.collect_killed_at_every_point(Path({str(tmp_path)!r})))
"""
    points = int(_python(script))
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
