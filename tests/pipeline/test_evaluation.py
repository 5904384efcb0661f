"""Evaluations, plans and comparisons of trained models."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from elast_cli.store.store import Store
from tests.toys.pipeline import ENV, SETS, TINY, run_in


def test_a_dry_evaluation_lists_what_it_would_make_and_no_more(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["eval", *ENV, *SETS, "--level", "hard", "--dry-run", "--json", "--quiet"]
    assert run_in(one, [*words, "--episodes", "2"]) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    kinds = ["eval elast", "eval cpc-cem", "eval random", "report"]
    assert [row["kind"] for row in rows] == kinds
    assert all(row["published"] for row in rows)
    assert run_in(one, [*words, "--episodes", "3"]) == 0
    rows = json.loads(capsys.readouterr().out)["artifacts"]
    assert [(row["kind"], row["published"]) for row in rows] == [(kind, None) for kind in kinds]


def test_eval_takes_every_environment_whose_artifacts_are_there(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    everywhere = [text for text in TINY if "save_every" not in text]  # some tasks ask for more
    sets = [word for text in everywhere for word in ("--set", text)]
    arguments = ["eval", *ENV[2:], *sets, "--level", "hard", "--episodes", "2", "--quiet"]
    assert run_in(one, [*arguments, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {row["method"] for row in document["overall"]} == {"elast", "cpc-cem", "random"}
    assert len(document["per_episode"]) == 6
    assert list(document["lineage"]) == ["block-s/report/v1"]


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


def test_where_shooting_refines_the_path_it_is_the_refined_one_that_is_explained(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["plan", *ENV, *SETS, "--scenario", "2", "--quiet", "--json"]
    assert run_in(one, arguments) == 0
    tree = json.loads(capsys.readouterr().out)["plan"]
    assert run_in(one, [*arguments, "--set", "planner.refine.iterations=8"]) == 0
    plan = json.loads(capsys.readouterr().out)["plan"]
    assert (tree["path_by"], plan["path_by"]) == ("tree", "shooting")
    assert plan["nodes"] == tree["nodes"]
    assert {entry["node"] for entry in plan["path"]} == {None}
    assert plan["steps"] == len(plan["path"]) - 1
    assert (
        max(entry["edge"]["prediction_error"] for entry in plan["path"][1:]) == 0
    )  # as rolled out
    ends = [found["goal"]["plan_end_distance"] for found in (plan, tree)]
    assert ends[0] <= ends[1] == tree["goal"]["nearest_node_distance"]
    assert plan["transitions"] > tree["transitions"]


def test_compare_pairs_the_episodes_of_two_evaluations(
    one: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(one, ["compare", "block-s/eval/v1", "block-s/eval/v2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows[-1]["n_pairs"] == 2
    assert run_in(one, ["compare", "block-s/report/v1", "block-s/report/v1"]) == 0
    assert "McNemar" in capsys.readouterr().out
    assert run_in(one, ["compare", "block-s/encoder/v1", "block-s/eval/v1"]) == 2
