"""Goal-conditioned policies through the command line, where obstacles change with the episode."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import PARAM, run_in

TASK = "block-param"
KINDS = {"cpc-gcbc": "gcbc", "v-gcbc": "pixel_gcbc", "cpc-gcidm": "gcidm", "cpc-gciql": "gciql"}
TINY = [
    "collect.n=300",
    "encoder.fit.steps=5",
    "pixel_gcbc.net.pool=4",
    "gciql.critic.width=16",
    *(f"{kind}.fit.{key}" for kind in KINDS.values() for key in ("steps=4", "batch_size=16")),
    *(f"{kind}.net.{key}" for kind in KINDS.values() for key in ("width=16", "depth=1")),
]
SETS = [*PARAM, *(word for text in TINY for word in ("--set", text))]
RUN = ["run", *SETS, "--methods", ",".join(KINDS), "--level", "standard", "--episodes", "1"]
RUN += ["--quiet", "--workers", "1"]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which all four were trained and evaluated."""
    home = tmp_path_factory.mktemp("policies")
    assert run_in(home, RUN) == 0
    return home


def test_each_policy_is_trained_on_what_it_needs_and_evaluated(done: Path) -> None:
    store = Store(done)
    for number, (method, kind) in enumerate(KINDS.items(), 1):
        made, evaluation = (store.manifest(Ref(TASK, *at)) for at in ((kind, 1), ("eval", number)))
        wanted = {"context"} if kind == "pixel_gcbc" else {"context", "encoder"}
        assert set(made.parents) == {"dataset", *wanted}
        assert "context: 16" in store.file(made.ref, "model.yaml").read_text()
        assert evaluation.recipe.config["method"] == method
        assert set(evaluation.parents) == {kind, *wanted}
    report = json.loads(store.file(Ref(TASK, "report", 1), "results.json").read_text())
    assert [row["method"] for row in report["per_episode"]] == [*KINDS]
    for row in report["per_episode"]:
        assert (row["plans"], row["policy_calls_per_step"]) == (0, 1)


def test_a_second_run_finds_all_of_it(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_in(done, [*RUN, "--dry-run", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    assert len(rows) == 3 + 2 * 4 + 1
    assert all(row["published"] for row in rows)


def test_only_the_arrival_is_no_part_of_a_training(
    done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*RUN, "--dry-run", "--json", "--set", "arrival.pace=2"]
    assert run_in(done, words) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    missing = [row["kind"] for row in rows if not row["published"]]
    assert missing == ["eval cpc-gcidm", "report"]


@pytest.mark.parametrize("method", KINDS)
def test_what_they_take_is_estimated_before(
    method: str, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", *PARAM, "--methods", method, "--level", "standard", "--dry-run", "--json"]
    assert run_in(home, words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["total"]["complete"] is True
    row = next(row for row in found["artifacts"] if row["kind"] == KINDS[method])
    assert row["disk_from"] == "shapes of tensors"
    assert min(row["disk_bytes"], row["memory_bytes"], row["seconds"]) > 0


@pytest.mark.parametrize("method", KINDS)
def test_they_make_no_plan_to_show(
    method: str, home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(home, ["plan", *PARAM[:4], "--method", method]) == 2
    said = capsys.readouterr().err
    assert f"--method {method}: this method grows no tree; choose elast" in said
    assert said.count("\n") == 1


def test_train_baseline_makes_what_one_of_them_needs(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train-baseline", "v-gcbc", *PARAM, "--dry-run", "--json"]
    assert run_in(home, words) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    assert [row["kind"] for row in rows] == ["dataset", "context", "pixel_gcbc"]
