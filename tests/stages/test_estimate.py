"""What a dry run says that things will take is what they take, and it makes nothing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from elast_cli.cli import app as cli
from elast_cli.envs.registry import task_info
from elast_cli.models.parts import PARTS
from elast_cli.stages import estimate, presets, train
from elast_cli.stages.earlier import number
from elast_cli.stages.job import Job
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.command_line import ELAST
from tests.toys.pipeline import ENV, RUN, SETS, run_in

ROOT = Path(__file__).parents[2]
MODELS = Store(ROOT / "docs/results/models")
# a process of its own, since a child's peak begins with that of the process that forked it
METER = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
KEYS = {"disk_bytes", "memory_bytes", "seconds", "disk_from", "seconds_from"}
TRAIN = ["train-encoder", *ENV, *SETS, "--quiet"]


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which everything ran; other tests only look at it."""
    home = tmp_path_factory.mktemp("chain")
    assert run_in(home, [*RUN, "--workers", "1"]) == 0
    return home


def dry(home: Path, capsys: pytest.CaptureFixture[str], words: list[str]) -> Any:
    """The JSON of a dry run."""
    assert run_in(home, [*words, "--dry-run", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def size(store: Store, ref: Ref) -> int:
    """Bytes of an artifact's files."""
    return sum(entry.size for entry in store.manifest(ref).files.values())


def test_a_dry_run_says_what_all_takes_and_makes_nothing(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = dry(home, capsys, RUN)
    assert len(found["artifacts"]) == 9
    for row in found["artifacts"]:
        assert row.keys() >= KEYS
        assert min(row["disk_bytes"], row["memory_bytes"], row["seconds"]) > 0, row
    for key in ("disk_bytes", "seconds"):
        parts = sum(row[key] for row in found["artifacts"])
        assert found["total"][key] == pytest.approx(parts)
    assert found["total"]["complete"] is True
    assert cli.run([*RUN, "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert all("rule of thumb" in line for line in lines[:-1])
    assert lines[-1].startswith("total: disk ")
    assert os.listdir(home) == []


def test_the_estimate_of_disk_is_what_a_run_writes(
    chain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(chain)
    versions = {"eval elast": "eval/v1", "eval cpc-cem": "eval/v2", "eval random": "eval/v3"}
    for row in dry(tmp_path, capsys, RUN)["artifacts"]:
        kind = row["kind"]
        real = size(store, Ref.parse(f"block-s/{versions.get(kind, kind + '/v1')}"))
        assert real / 2 < row["disk_bytes"] < real * 2, kind


@pytest.mark.parametrize("told", [None, "avx2"])
def test_auto_precision_is_the_one_that_training_takes(
    told: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """torch reads the variable when it is imported, so it is asked in a process of its own."""
    monkeypatch.delenv("ATEN_CPU_CAPABILITY", raising=False)
    if told:
        monkeypatch.setenv("ATEN_CPU_CAPABILITY", told)
    script = "from elast_cli.models.precision import resolved; print(resolved('auto', 'cpu'))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert estimate._in_bfloat16("auto", "cpu") == (done.stdout.strip() == "bfloat16")


@pytest.mark.parametrize("ref", [ref for ref in MODELS.refs() if ref.kind in PARTS], ids=str)
def test_the_estimate_of_disk_is_that_of_the_committed_models(ref: Ref, tmp_path: Path) -> None:
    manifest = MODELS.manifest(ref)
    recipe: Any = manifest.recipe
    asked = recipe.config[ref.kind]["fit"]["precision"]
    precision = manifest.metrics["precision"] if asked == "auto" else asked
    config = presets.load("standard", ref.env, [f"{ref.kind}.fit.precision={precision}"])
    job = Job(store=Store(tmp_path), env=ref.env, preset="standard", config=config)
    found = estimate.of_role(job, ref.kind, {}).disk_bytes
    assert found == pytest.approx(size(MODELS, ref), rel=0.06)


@pytest.mark.slow
def test_the_estimate_of_memory_is_what_a_training_takes(
    chain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(chain / "data", tmp_path / "data")
    expected = dry(tmp_path, capsys, TRAIN)["memory_bytes"]
    env = {**os.environ, "ELAST_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-c", METER, *ELAST, *TRAIN]
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=True)
    real = 1024 * int(done.stdout.split()[-1])
    assert real / 1.6 < expected < real * 1.6, real


def test_images_count_where_they_are_held(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train, "available", lambda: 100e9)
    million = replace(job, config=presets.load("quick", job.env, ["collect.n=1000000"]))
    rows = 20_000 * 51
    streamed = estimate.of_role(million, "encoder", {}).memory_bytes
    held = estimate.of_role(replace(million, memory_gb=20.0), "encoder", {}).memory_bytes
    assert streamed is not None
    assert held is not None
    assert held - streamed == rows * 16 * 16 * 3 * 2
    assert streamed == pytest.approx(0.71e9, rel=0.25)  # docs/results/costs.md


def test_seconds_are_those_of_an_earlier_artifact_by_its_steps(
    chain: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    earlier = Store(chain).manifest(Ref("block-s", "encoder", 1))
    found = dry(chain, capsys, [*TRAIN, "--steps", "4000"])
    assert found["seconds_from"] == "from block-s/encoder/v1"
    assert found["seconds"] == pytest.approx(100 * number(earlier.metrics, "wall_s"), abs=0.1)
    other = dry(chain, capsys, [*TRAIN, "--batch-size", "64"])
    assert other["seconds_from"] == "rule of thumb"


def test_data_and_episodes_are_scaled_from_earlier_ones(
    chain: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(chain)
    words = [*RUN, "--set", "collect.n=15000", "--level", "medium,hard", "--episodes", "20"]
    found = {row["kind"]: row for row in dry(chain, capsys, words)["artifacts"]}
    data, evaluation = found["dataset"], found["eval cpc-cem"]
    assert data["disk_from"] == data["seconds_from"] == "from block-s/dataset/v1"
    assert data["disk_bytes"] == pytest.approx(10 * size(store, Ref("block-s", "dataset", 1)))
    assert evaluation["seconds_from"] == "from block-s/eval/v2"
    levels = task_info("block-s").levels
    share = sum(level.max_steps for level in levels.values()) / levels["hard"].max_steps
    wall = number(store.manifest(Ref("block-s", "eval", 2)).metrics, "wall_s")
    assert evaluation["seconds"] == pytest.approx(20 / 2 * share * wall, abs=0.1)


def test_what_is_there_takes_nothing_more(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = dry(chain, capsys, RUN)
    assert found["total"] == {"disk_bytes": 0, "seconds": 0, "complete": True}
    assert all(row["published"] for row in found["artifacts"])
    assert dry(chain, capsys, TRAIN)["disk_bytes"] == 0


def test_what_nothing_tells_is_unknown(
    home: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimate, "FRAME", {})
    found = dry(home, capsys, RUN)
    data = found["artifacts"][0]
    assert (data["disk_bytes"], data["seconds"]) == (None, None)
    assert (data["disk_from"], data["seconds_from"]) == ("unknown", "unknown")
    assert found["total"]["complete"] is False
    assert cli.run([*RUN, "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "disk unknown" in out
    assert "time at least" in out


def test_a_gpu_makes_seconds_and_memory_unknown(job: Job) -> None:
    found = estimate.of_role(replace(job, device="cuda"), "encoder", {})
    assert (found.memory_bytes, found.seconds) == (None, None)
    assert found.disk_bytes


@pytest.mark.parametrize("data", [{}, {"a": None}, {"a": {"b": "1"}}, {"a": {"b": -1}}, {"a": []}])
def test_a_manifest_without_a_number_tells_nothing(data: object) -> None:
    assert number(data, "a", "b") != number(data, "a", "b")  # NaN
    assert number({"a": {"b": 2}}, "a", "b") == 2
