"""One tiny pipeline through the command line: everything runs, and runs the same every time."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from elast_cli.cli import app as cli
from elast_cli.data.layout import column_digests
from elast_cli.stages import evaluate
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

ENV = ["--env", "block-s", "--preset", "quick"]
TINY = [
    "collect.n=1500",
    "encoder.fit.steps=40",
    "encoder.fit.save_every=5",
    "ensemble.fit.steps=20",
    "density.fit.steps=20",
    "ensemble.net.support_size=500",
    "policy.fit.steps=20",
    "planner.expansions=60",
    "cem.num_samples=12",
    "cem.topk=4",
    "cem.n_steps=2",
    "cem.horizon=10",
]
SETS = [word for text in TINY for word in ("--set", text)]
RUN = ["run", *ENV, *SETS, "--level", "hard", "--episodes", "2", "--quiet"]
MODELS = ("encoder", "ensemble", "density", "policy")


def run_in(home: Path, arguments: list[str]) -> int:
    """The exit code of a command line with its own $ELAST_HOME."""
    before = os.environ.get("ELAST_HOME")
    os.environ["ELAST_HOME"] = str(home)
    try:
        return cli.run(arguments)
    finally:
        if before is None:
            del os.environ["ELAST_HOME"]
        else:
            os.environ["ELAST_HOME"] = before


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which everything ran with one worker."""
    home = tmp_path_factory.mktemp("one")
    assert run_in(home, [*RUN, "--workers", "1"]) == 0
    return home


def weights(home: Path) -> dict[str, str]:
    """SHA-256 of every model's weights."""
    store = Store(home)
    return {
        kind: store.manifest(Ref("block-s", kind, 1)).files["model.safetensors"].sha256
        for kind in MODELS
    }


def episodes(home: Path) -> list[dict[str, Any]]:
    """The report's episodes without wall times."""
    path = home / "artifacts/block-s/report/v1/results.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text())["per_episode"]
    return [
        {key: value for key, value in row.items() if not key.endswith("plan_s")} for row in rows
    ]


def test_the_chain_leaves_a_report_with_pictures(one: Path) -> None:
    names = set(os.listdir(one / "artifacts/block-s/report/v1"))
    assert {"results.json", "table.txt", "success.png", "manifest.yaml"} <= names
    for method in ("elast", "cpc-cem", "random"):
        for kind in ("png", "gif"):
            assert any(n.startswith(f"{method}-hard") and n.endswith(kind) for n in names)
    rows = episodes(one)
    assert [(row["method"], row["episode_ix"]) for row in rows] == [
        (method, index) for method in ("elast", "cpc-cem", "random") for index in range(2)
    ]
    assert not list((one / "artifacts/.runs").glob("*"))
    assert not list((one / "artifacts/.staging").glob("*"))


def test_two_workers_give_the_same_data_weights_and_episodes(one: Path, tmp_path: Path) -> None:
    assert run_in(tmp_path, [*RUN, "--workers", "2"]) == 0
    dataset = "data/block-s/dataset/v1/dataset.h5"
    assert column_digests(one / dataset) == column_digests(tmp_path / dataset)
    assert weights(one) == weights(tmp_path)
    assert episodes(one) == episodes(tmp_path)


def test_a_training_killed_twice_ends_with_the_same_weights(one: Path, tmp_path: Path) -> None:
    shutil.copytree(one / "data", tmp_path / "data")
    command = [sys.executable, "-m", "elast_cli", "train-encoder", *ENV, *SETS, "--quiet"]
    environment = {**os.environ, "ELAST_HOME": str(tmp_path)}
    runs = tmp_path / "artifacts/.runs"
    newest = 0.0
    for _ in range(2):
        process = subprocess.Popen(command, env=environment)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            stamps = [path.stat().st_mtime for path in runs.glob("*/checkpoint.pt")]
            if stamps and stamps[0] > newest:
                newest = stamps[0]
                break
            time.sleep(0.002)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert Store(tmp_path).refs("block-s", "encoder") == []
    arguments = ["train-encoder", *ENV, *SETS, "--quiet"]
    assert run_in(tmp_path, arguments) == 0
    store = Store(tmp_path)
    found = store.manifest(Ref("block-s", "encoder", 1)).files["model.safetensors"].sha256
    assert found == weights(one)["encoder"]


def test_an_interrupted_or_damaged_evaluation_continues_and_ends_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["eval", *ENV, "--methods", "random", "--level", "medium", "--episodes", "6"]
    words += ["--num-envs", "2", "--workers", "1"]
    assert run_in(tmp_path / "whole", [*words, "--quiet"]) == 0

    def interrupted(task: Any, items: Any, *, workers: int) -> Any:
        yield task(items[0])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(evaluate, "each", interrupted)
        assert run_in(tmp_path / "cut", words) == 130
    assert Store(tmp_path / "cut").refs() == []
    done = sorted((tmp_path / "cut/artifacts/.runs").glob("*/medium-*.json"))
    assert len(done) == 2
    done[0].write_bytes(done[0].read_bytes()[:10])
    for frames in done[0].parent.glob("*.npz"):
        frames.write_bytes(b"")
    assert run_in(tmp_path / "cut", [*words, "--quiet"]) == 0
    assert episodes(tmp_path / "cut") == episodes(tmp_path / "whole")


@pytest.mark.parametrize("where", ["encoder.fit.save_every=5", "encoder.fit.save_every=5000"])
def test_a_full_disk_ends_a_training_with_one_line_and_leaves_nothing_half_written(
    one: Path, tmp_path: Path, where: str
) -> None:
    shutil.copytree(one / "data", tmp_path / "data")
    words = ["train-encoder", *ENV, *SETS, "--set", where, "--quiet"]
    limited = f'ulimit -f 256; exec "{sys.executable}" -m elast_cli "$@"'  # kB a file
    done = subprocess.run(
        ["bash", "-c", limited, "bash", *words],
        env={**os.environ, "ELAST_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 74, done.stderr
    assert done.stderr.startswith("elast: storage failed:")
    assert len(done.stderr.splitlines()) == 1
    assert Store(tmp_path).refs("block-s", "encoder") == []
    assert not list((tmp_path / "artifacts/.staging").glob("*"))
    assert not list((tmp_path / "artifacts/.runs").glob("*/checkpoint*"))


def test_a_second_run_does_no_work(one: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = Store(one).refs()
    assert run_in(one, [*RUN, "--workers", "1"]) == 0
    assert "block-s/report/v1" in capsys.readouterr().out
    assert Store(one).refs() == before
    assert run_in(one, [*RUN, "--dry-run", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == 9
    assert all(row["published"] for row in rows)


def test_a_dry_evaluation_lists_what_it_would_make_and_no_more(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["eval", *ENV, *SETS, "--level", "hard", "--dry-run", "--json", "--quiet"]
    assert run_in(one, [*words, "--episodes", "2"]) == 0
    rows = json.loads(capsys.readouterr().out)
    kinds = ["eval elast", "eval cpc-cem", "eval random", "report"]
    assert [row["kind"] for row in rows] == kinds
    assert all(row["published"] for row in rows)
    assert run_in(one, [*words, "--episodes", "3"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["kind"], row["published"]) for row in rows] == [(kind, None) for kind in kinds]


def test_a_search_is_bounded_by_flags_and_a_time_budget_is_told(
    one: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(one, tmp_path / "home")
    words = ["plan", *ENV, *SETS, "--json"]
    plans, store = [], Store(tmp_path / "home")
    for bound in (["--max-nodes", "7"], ["--time-budget", "1e-5"]):
        assert run_in(tmp_path / "home", [*words, *bound]) == 0
        captured = capsys.readouterr()
        plans.append(json.loads(captured.out)["plan"])
        assert ("elast: plans of at most 1e-05 s each are not repeatable" in captured.err) == (
            bound[0] == "--time-budget"
        )
    configs = [store.manifest(ref).recipe.config for ref in store.refs("block-s", "plan")]
    searches = [json.loads(json.dumps(config))["sections"]["planner"] for config in configs[-2:]]
    assert [planner["max_nodes"] for planner in searches] == [7, None]
    assert [planner["time_budget"] for planner in searches] == [None, 1e-5]
    assert [plan["repeatable"] for plan in plans] == [True, False]
    words = ["eval", *ENV, *SETS, "--methods", "elast,random", "--level", "hard"]
    assert run_in(tmp_path / "home", [*words, "--episodes", "1", "--time-budget", "0.001"]) == 0
    assert "elast: plans of at most 0.001 s each" in capsys.readouterr().err
    found = [store.manifest(ref) for ref in store.refs("block-s", "eval")[-2:]]
    assert [(m.recipe.config["method"], m.metrics["repeatable"]) for m in found] == [
        ("elast", False),
        ("random", True),
    ]


def test_eval_takes_every_environment_whose_artifacts_are_there(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["eval", *ENV[2:], *SETS, "--level", "hard", "--episodes", "2", "--quiet"]
    assert run_in(one, [*arguments, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {row["method"] for row in document["overall"]} == {"elast", "cpc-cem", "random"}
    assert len(document["per_episode"]) == 6
    assert list(document["lineage"]) == ["block-s/report/v1"]


def test_a_missed_requirement_exits_3_after_the_table(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(one, [*RUN, "--require", "random<=50", "--require", "random>=99"]) == 3
    captured = capsys.readouterr()
    assert "random" in captured.out
    assert captured.err.startswith("elast: missed: random>=99")
    assert run_in(one, [*RUN, "--require", "rando>=1"]) == 2
    assert "did you mean" in capsys.readouterr().err


def test_plan_explains_every_edge(one: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["plan", *ENV, *SETS, "--scenario", "1", "--quiet"]
    assert run_in(one, [*arguments, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    plan = document["plan"]
    assert plan["steps"] == len(plan["path"]) - 1
    for entry in plan["path"][1:]:
        edge = entry["edge"]
        assert edge["log_density"] >= plan["limits"]["min_log_density"]
        assert {"variance", "round_trip", "decoded_jump", "action"} <= set(edge)
    assert (one / "artifacts/block-s/plan/v1/plan.png").stat().st_size > 10_000
    assert run_in(one, arguments) == 0
    assert capsys.readouterr().out == "block-s/plan/v1\n"
    assert run_in(one, [*arguments, "--method", "random"]) == 2
    assert "choose elast" in capsys.readouterr().err


def test_compare_pairs_the_episodes_of_two_evaluations(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(one, ["compare", "block-s/eval/v1", "block-s/eval/v2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows[-1]["n_pairs"] == 2
    assert run_in(one, ["compare", "block-s/report/v1", "block-s/report/v1"]) == 0
    assert "McNemar" in capsys.readouterr().out
    assert run_in(one, ["compare", "block-s/encoder/v1", "block-s/eval/v1"]) == 2


def test_everything_verifies_down_to_the_data(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(one, ["verify", "--json"]) == 0
    assert all(row["ok"] for row in json.loads(capsys.readouterr().out))
    assert run_in(one, ["show", "block-s/report/v1"]) == 0
    assert "dataset: block-s/dataset/v1" in capsys.readouterr().out


# --- where obstacles change with the episode -----------------------------------------------------

PARAM = ["--env", "block-param", "--preset", "quick", *SETS, "--set", "collect.n=600"]
PARAM += ["--set", "context.fit.steps=10", "--set", "context.fit.batch_size=16"]


@pytest.fixture(scope="module")
def with_context(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which everything ran in an environment with contexts."""
    home = tmp_path_factory.mktemp("param")
    words = ["run", *PARAM, "--episodes", "2", "--quiet", "--workers", "1"]
    assert run_in(home, words) == 0
    return home


def test_contexts_are_part_of_every_lineage_that_learns(with_context: Path) -> None:
    store = Store(with_context)
    context = str(Ref("block-param", "context", 1))
    for kind in MODELS:
        manifest = store.manifest(Ref("block-param", kind, 1))
        assert manifest.parents["context"].ref == context
        assert "context: 16" in store.file(manifest.ref, "model.yaml").read_text()
    evaluations = {
        str(manifest.recipe.config["method"]): manifest.parents
        for manifest in map(store.manifest, store.refs("block-param", "eval"))
    }
    for method in ("elast", "cpc-cem"):
        assert evaluations[method]["context"].ref == context
    assert not evaluations["random"]
    files = store.manifest(Ref.parse(context)).files
    assert {"model.safetensors", "model.yaml", "metrics.csv", "reconstructions.png"} <= set(files)


def test_a_plan_takes_the_context_of_its_scenario(
    with_context: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["plan", *PARAM, "--quiet"]
    assert run_in(with_context, [*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["plan"]["nodes"] >= 1
    assert run_in(with_context, ["show", "block-param/plan/v1"]) == 0
    assert "context: block-param/context/v1" in capsys.readouterr().out


def test_a_second_run_with_contexts_does_no_work(
    with_context: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", *PARAM, "--episodes", "2", "--quiet", "--dry-run", "--json"]
    assert run_in(with_context, words) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["kind"] for row in rows[:3]] == ["dataset", "context", "encoder"]
    assert len(rows) == 10
    assert all(row["published"] for row in rows)


def test_two_workers_give_the_same_episodes_with_contexts(
    with_context: Path, tmp_path: Path
) -> None:
    shutil.copytree(with_context, tmp_path / "home")
    words = ["eval", *PARAM, "--methods", "cpc-cem", "--episodes", "2", "--quiet", "--force"]
    assert run_in(tmp_path / "home", [*words, "--workers", "2", "--num-envs", "1"]) == 0
    store = Store(tmp_path / "home")
    evaluations = [
        manifest.ref
        for manifest in map(store.manifest, store.refs("block-param", "eval"))
        if manifest.recipe.config["method"] == "cpc-cem"
    ]
    once, again = (
        [
            {key: value for key, value in row.items() if not key.endswith("plan_s")}
            for row in json.loads(store.file(ref, "results.json").read_text())["per_episode"]
        ]
        for ref in evaluations
    )
    assert once == again
