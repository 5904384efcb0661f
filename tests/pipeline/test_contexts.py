"""The whole chain where obstacles change with the episode."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import MEASURED, MODELS, PARAM, run_in


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
    rows = json.loads(capsys.readouterr().out)["artifacts"]
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
            {key: value for key, value in row.items() if not key.endswith(MEASURED)}
            for row in json.loads(store.file(ref, "results.json").read_text())["per_episode"]
        ]
        for ref in evaluations
    )
    assert once == again
