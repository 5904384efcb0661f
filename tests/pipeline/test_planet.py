"""PlaNet through the command line, where obstacles change with the episode."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import run_in

TASK = "block-param"
TINY = [
    "collect.n=300",
    "rssm.net.channels=2",
    "rssm.net.belief=8",
    "rssm.elbo.length=5",
    "rssm.fit.steps=3",
    "rssm.fit.batch_size=2",
    "planet.num_samples=6",
    "planet.topk=2",
    "planet.n_steps=2",
]
SETS = ["--env", TASK, "--preset", "quick", *(word for text in TINY for word in ("--set", text))]
RUN = ["run", *SETS, "--methods", "planet", "--level", "standard", "--episodes", "1"]
RUN += ["--quiet", "--workers", "1"]


def test_it_is_estimated_trained_evaluated_and_found_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    baseline = ["train-baseline", "planet", *SETS, "--dry-run", "--json"]
    assert run_in(tmp_path, baseline) == 0
    planned = json.loads(capsys.readouterr().out)["artifacts"]
    assert [row["kind"] for row in planned] == ["dataset", "rssm"]
    assert run_in(tmp_path, [*RUN, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["total"]["complete"] is True
    assert run_in(tmp_path, RUN) == 0
    store = Store(tmp_path)
    made, evaluation = (store.manifest(Ref(TASK, kind, 1)) for kind in ("rssm", "eval"))
    assert set(made.parents) == {"dataset"}  # the images show the obstacles
    assert {"val_loss", "val_open_loop_rmse", "probe_knn_r2", "probe_linear_r2"} <= {*made.metrics}
    assert "reconstructions.png" in made.files
    assert set(evaluation.parents) == {"rssm"}
    report = json.loads(store.file(Ref(TASK, "report", 1), "results.json").read_text())
    row = report["per_episode"][0]
    assert row["method"] == "planet"
    assert row["plans"] >= 1
    capsys.readouterr()
    assert run_in(tmp_path, [*RUN, "--dry-run", "--json"]) == 0
    assert all(row["published"] for row in json.loads(capsys.readouterr().out)["artifacts"])
    assert run_in(tmp_path, ["train-rssm", *SETS, "--set", "rssm.fit.steps=4", "--quiet"]) == 0
    assert capsys.readouterr().out.strip() == f"{TASK}/rssm/v2"
