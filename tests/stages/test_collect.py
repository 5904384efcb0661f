"""Collection: shards, workers, interruption."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from elast_cli.control.collection import collect_episode
from elast_cli.data.chunks import CHUNK_ROWS
from elast_cli.data.layout import column_digests
from elast_cli.data.shards import shard_path
from elast_cli.errors import DataError
from elast_cli.stages import collect, presets, train
from elast_cli.stages.job import Job
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.lineages import ENV
from tests.toys.notes import Notes


def dataset_of(job: Job) -> tuple[Ref, dict[str, str]]:
    ref = collect.recipe_job(job).carry_out()
    return ref, column_digests(job.store.file(ref, collect.DATASET_FILE))


def test_any_number_of_workers_collects_the_same(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collect, "SHARD_ROWS", 300)  # 14 episodes, whose end is no chunk's end
    config = presets.load("quick", ENV, ["collect.n=900", "collect.episode_steps=20"])
    digests = []
    for workers in (1, 2):
        store = Store(tmp_path / f"with-{workers}")
        ref, columns = dataset_of(replace(job, store=store, config=config, workers=workers))
        digests.append((columns, store.manifest(ref).files))
    assert digests[0] == digests[1]


@pytest.mark.parametrize("rows", [11, 21, 26, 51, 64])
def test_shards_of_short_episodes_are_whole_chunks(rows: int) -> None:
    shares = collect._shares(1000, rows)
    assert [index for share in shares for index in share] == list(range(1000))
    for share in shares[:-1]:
        assert len(share) * rows % CHUNK_ROWS == 0
        assert collect.SHARD_ROWS / 2 < len(share) * rows <= collect.SHARD_ROWS * 2


def test_shards_of_long_episodes_stay_short() -> None:
    assert {len(share) * 501 for share in collect._shares(100, 501)} == {2004}


def test_an_interrupted_collection_ends_the_same_and_runs_only_what_is_missing(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collect, "SHARD_ROWS", 22)  # two episodes
    _, whole = dataset_of(replace(job, store=Store(tmp_path / "whole")))
    ran: list[int] = []
    original = collect_episode

    def counted(*args: object, index: int, **rest: object) -> object:
        if len(ran) == 5:
            raise KeyboardInterrupt
        ran.append(index)
        return original(*args, index=index, **rest)  # type: ignore[arg-type]  # passed through

    monkeypatch.setattr(collect, "collect_episode", counted)
    with pytest.raises(KeyboardInterrupt):
        dataset_of(job)
    assert job.store.refs() == []
    monkeypatch.setattr(collect, "collect_episode", original)
    notes = Notes()
    _, resumed = dataset_of(replace(job, progress=notes))
    assert resumed == whole
    assert ran == list(range(5))
    assert "4 episodes already exist" in notes.said[0]


def test_shards_that_were_cut_otherwise_are_collected_anew(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, whole = dataset_of(replace(job, store=Store(tmp_path / "whole")))
    with monkeypatch.context() as patch:
        patch.setattr(collect, "SHARD_ROWS", 22)  # two episodes
        patch.setattr(collect, "compact", interrupt)
        with pytest.raises(KeyboardInterrupt):
            dataset_of(job)
    notes = Notes()
    monkeypatch.setattr(collect, "SHARD_ROWS", 33)
    _, resumed = dataset_of(replace(job, progress=notes))
    assert resumed == whole
    assert not notes.said


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_damaged_episodes_are_named_and_fresh_forgets_them(job: Job) -> None:
    wanted = collect.recipe_job(replace(job, fresh=True))
    with job.store.begin(wanted.recipe, parents={}) as run:
        shard_path(run.work, 0).write_text("left by a broken disk")
    with pytest.raises(DataError, match=r"episodes-0000000\.h5: .*--fresh"):
        collect.recipe_job(job).carry_out()
    ref = wanted.carry_out()
    assert job.store.manifest(ref).metrics["episodes"] == 6


def test_threads_and_device_are_no_part_of_a_dataset(job: Job) -> None:
    first = collect.recipe_job(job).carry_out()
    assert collect.recipe_job(replace(job, threads=2, workers=2)).carry_out() == first


def test_too_little_to_train_on_is_refused_before_training(job: Job) -> None:
    collect.recipe_job(job).carry_out()
    training = train.recipe_job(job, "encoder")
    with pytest.raises(DataError, match=r"60 transitions are too few.* at least 200.*--n 200$"):
        training.carry_out()
    assert not job.store.refs(kind="encoder")
