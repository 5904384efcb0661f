"""HTM through the command line: trained, evaluated and found again, with and without contexts."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import run_in

ROOT = Path(__file__).parents[2]
TASKS = ("block-s", "block-param")
TINY = [
    "collect.n=300",
    "cvae.net.channels=4",
    "cvae.net.pool=4",
    "hallucination.samples=30",
    "htm.pairs.negatives=5",
    *(f"{kind}.fit.{key}" for kind in ("cvae", "htm") for key in ("steps=3", "batch_size=16")),
]


def words(task: str) -> list[str]:
    sets = [word for text in TINY for word in ("--set", text)]
    level = "medium" if task == "block-s" else "standard"
    run = ["run", "--env", task, "--preset", "quick", *sets, "--methods", "htm", "--level", level]
    return [*run, "--episodes", "1", "--workers", "1", "--quiet"]


@pytest.fixture(scope="module", params=TASKS)
def done(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """A task, and a home in which it was trained and evaluated."""
    home = tmp_path_factory.mktemp("htm")
    assert run_in(home, words(request.param)) == 0
    return request.param, home


def test_both_parts_are_trained_and_the_method_evaluated(done: tuple[str, Path]) -> None:
    task, home = done
    store = Store(home)
    cvae, htm, evaluation = (store.manifest(Ref(task, kind, 1)) for kind in ("cvae", "htm", "eval"))
    assert set(cvae.parents) == {"dataset"}
    assert "reconstructions.png" in cvae.files
    assert set(htm.parents) == {"dataset", "cvae"}
    assert set(evaluation.parents) == {"cvae", "htm"}
    spec = store.file(htm.ref, "model.yaml").read_text()
    assert f"has_context: {'true' if task == 'block-param' else 'false'}" in spec
    assert {"val_bce_excess", "val_kl", "val_probe_linear_r2"} <= cvae.metrics.keys()
    assert {"val_info_nce", "val_accuracy", "val_action_r2"} <= htm.metrics.keys()
    report = json.loads(store.file(Ref(task, "report", 1), "results.json").read_text())
    (row,) = report["per_episode"]
    assert (row["method"], row["network_calls_per_step"]) == ("htm", 0)
    assert row["plans"] >= 1
    assert row["density_calls_per_step"] > 0


def test_a_second_run_finds_all_of_it(
    done: tuple[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    task, home = done
    assert run_in(home, [*words(task), "--dry-run", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    assert [row["kind"] for row in rows] == ["dataset", "cvae", "htm", "eval htm", "report"]
    assert all(row["published"] for row in rows)
    changed = [*words(task), "--set", "hallucination.waypoint_steps=5", "--dry-run", "--json"]
    assert run_in(home, changed) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    assert [row["kind"] for row in rows if not row["published"]] == ["eval htm", "report"]


def test_the_example_draws_a_plan(
    done: tuple[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, home = done
    monkeypatch.setenv("ELAST_HOME", str(home))
    example = runpy.run_path(str(ROOT / "examples/hallucinate_a_plan.py"))["main"]
    level = words(task)[words(task).index("--level") + 1]
    plan = example(task, level, TINY, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 1000
    assert plan.images.shape[1:] == (16, 16, 3)
    assert len(plan.weights) == len(plan.images) - 1
    assert np.all(plan.weights >= 1)
    assert len(Store(home).refs(task, "htm")) == 1  # nothing was trained again


@pytest.mark.parametrize("task", TASKS)
def test_what_it_takes_is_estimated_before(
    task: str, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train-baseline", "htm", "--env", task, "--preset", "quick", "--dry-run", "--json"]
    assert run_in(home, command) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["total"]["complete"] is True
    assert [row["kind"] for row in found["artifacts"]] == ["dataset", "cvae", "htm"]
    for row in found["artifacts"][1:]:
        assert row["disk_from"] == "shapes of tensors"
        assert min(row["disk_bytes"], row["memory_bytes"], row["seconds"]) > 0
