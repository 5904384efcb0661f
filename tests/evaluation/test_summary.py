"""Episode rows to summaries, the results document and the table for people."""

from __future__ import annotations

import io
import json
import math
from typing import Any

import pytest
from pydantic import ValidationError
from rich.console import Console

from elast_cli.errors import DataError
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.evaluation.statistics import wilson
from elast_cli.evaluation.summary import parse_results, pooled, results_document, summarize
from elast_cli.evaluation.tables import table


def episode(index: int = 0, **changes: Any) -> EpisodeRow:
    fields: dict[str, Any] = {
        "env": "block-s",
        "level": "hard",
        "method": "elast",
        "train_seed": 0,
        "episode_ix": index,
        "seed": 7,
        "success": True,
        "steps": 48,
        "shortest": 40,
        "plans": 2,
        "plan_s": 1.5,
        "network_calls_per_step": 1000.0,
        "held": True,
    }
    if changes.get("success") is False:
        fields |= {"steps": None, "held": False}
    return EpisodeRow(**(fields | changes))


ROWS = [
    episode(0, steps=40, plan_s=1.0, plans=1),
    episode(1, steps=60, plan_s=3.0, plans=3, held=False),
    episode(2, success=False, shortest=50),
    episode(0, train_seed=1, success=False),
    episode(1, train_seed=1, success=False),
]


def test_a_summary_agrees_with_hand_numbers() -> None:
    first, second, both = summarize(ROWS)
    assert (first.train_seed, second.train_seed, both.train_seed) == (0, 1, None)
    assert first.pc_success == pytest.approx(200 / 3)
    assert first.ci95 == wilson(2, 3)
    assert first.pc_held == pytest.approx(100 / 3)
    assert first.steps == 50.0
    assert first.steps_over_shortest == 1.25
    assert first.plan_s == pytest.approx((1.0 + 9.0 + 3.0) / 6)
    assert both.n_episodes == 5
    assert both.pc_success == 40.0
    assert both.pc_success_by_seed == {"0": pytest.approx(200 / 3), "1": 0.0}
    assert both.pc_success_std == pytest.approx(200 / 3 / math.sqrt(2))


def test_a_method_that_never_succeeds_or_plans_has_null_where_there_is_no_number() -> None:
    rows = [episode(0, method="random", success=False, plans=0, plan_s=0.0, shortest=None)]
    row = pooled(summarize(rows))[0]
    assert (row.steps, row.steps_over_shortest, row.plan_s, row.pc_success_std) == (None,) * 4


def test_a_summary_does_not_depend_on_the_order_of_the_episodes() -> None:
    assert summarize(ROWS) == summarize([*ROWS[:3][::-1], *ROWS[3:]])


def test_an_episode_that_appears_twice_is_refused() -> None:
    with pytest.raises(DataError, match=r"episode 0 of elast on block-s/hard.*twice"):
        summarize([episode(0), episode(0)])


@pytest.mark.parametrize(
    "changes",
    [
        {"success": True, "steps": None},
        {"success": False, "steps": 3},
        {"success": False, "held": True},
        {"episode_ix": -1},
        {"plan_s": float("nan")},
        {"success": 1},
        {"surprise": 1},
    ],
)
def test_a_row_that_contradicts_itself_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        episode(**changes)


def test_the_document_survives_json_and_holds_no_nan() -> None:
    lineage = {"encoder": {"ref": "block-s/encoder/v1", "digests": ("ab", "cd")}}
    settings: dict[str, Any] = {
        "scenario_seed": 7,
        "threshold": float("nan"),
        "bound": float("-inf"),
        "none": None,
    }
    text = json.dumps(results_document(ROWS, lineage, settings), allow_nan=False)
    results = parse_results(json.loads(text))
    assert results.per_episode == ROWS
    assert results.overall == summarize(ROWS)
    assert results.settings == {"scenario_seed": 7, "threshold": None, "bound": None, "none": None}
    assert results.lineage == {"encoder": {"ref": "block-s/encoder/v1", "digests": ["ab", "cd"]}}


def test_the_document_has_the_fields_other_tools_read() -> None:
    document = json.loads(json.dumps(results_document(ROWS, {}, {})))
    needed = {"env", "level", "method", "train_seed", "pc_success", "ci95", "n_episodes"}
    assert needed <= set(document["overall"][0])
    assert {"episode_ix", "success", "seed", "steps", "plan_s"} <= set(document["per_episode"][0])


def damaged(**changes: Any) -> dict[str, Any]:
    document: dict[str, Any] = results_document(ROWS, {}, {})
    document["per_episode"][0] |= changes
    return document


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "expected a JSON object, got list"),
        ({"schema_version": 99}, "schema_version 99 is newer than 1.*pip install --upgrade"),
        ({"schema_version": 1}, "overall: Field required"),
        (damaged(steps="many"), r"per_episode\.0\.steps: .*'many'"),
        (damaged(train_seed=1), "is there twice"),
        (damaged(extra=1), r"per_episode\.0\.extra"),
    ],
)
def test_a_damaged_document_is_refused_in_one_line(document: Any, message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        parse_results(document)
    assert "\n" not in str(caught.value)


def test_the_table_shows_each_method_with_its_interval() -> None:
    rows = [*ROWS, episode(0, method="random", success=False, plans=0, plan_s=0.0)]
    console = Console(width=160, file=io.StringIO(), record=True)
    console.print(table(summarize(rows)))
    lines = [line.split() for line in console.export_text().splitlines() if line.strip()]
    assert lines[3][:5] == ["block-s", "hard", "elast", "40.0", "[11.8,"]
    assert lines[3][-3:] == ["5", "67", "0"]
    assert lines[4][:2] == ["random", "0.0"]
    assert len(lines) == 5


def test_the_table_of_one_seed_has_no_column_by_seed() -> None:
    assert len(table(summarize(ROWS)).columns) == len(table(summarize(ROWS[:3])).columns) + 1
