"""How much memory is free, as the system tells it."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from elast_cli import memory
from elast_cli.cli import app
from elast_cli.errors import StorageError
from elast_cli.stages import collect, presets, train
from elast_cli.stages.job import Job
from elast_cli.store.store import Store


def test_the_least_of_all_bounds_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "GROUP", tmp_path)
    free = memory.available()
    assert 0 < free < 1 << 50
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("7\n")
    assert memory._group() == float("inf")
    (tmp_path / "memory.max").write_text("1007\n")
    assert memory.available() == 1000
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 5\n")
    assert memory.available() == 1005  # files that can be read again are not in the way
    (tmp_path / "memory.max").write_text("what?\n")
    assert memory._group() == float("inf")


def test_the_shells_limit_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _which: (1 << 60, 1 << 60))
    assert 0 < memory._limit() < 1 << 60
    monkeypatch.setattr(resource, "getrlimit", lambda _which: (resource.RLIM_INFINITY,) * 2)
    assert memory._limit() == float("inf")


def test_a_training_that_does_not_fit_is_refused_before_it_begins(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = presets.load("quick", "block-s", ["collect.n=300", "collect.episode_steps=30"])
    job = Job(store=Store(home), env="block-s", preset="quick", config=config)
    collect.recipe_job(job).carry_out()
    monkeypatch.setattr(train, "available", lambda: 1e8)
    with pytest.raises(StorageError, match=r"310 frames takes 0.2 GB of memory, 0.1 GB are free"):
        train.recipe_job(job, "encoder").carry_out()


def test_memory_that_runs_out_is_one_line(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def greedy(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(collect, "recipe_job", greedy)
    assert app.run(["collect", "--env", "block-s"]) == 74
    assert capsys.readouterr().err.startswith("elast: out of memory; the same command continues")
