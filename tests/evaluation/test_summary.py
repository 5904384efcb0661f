"""Episode rows to summaries and the results document."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from pydantic import ValidationError

from elast_cli.errors import DataError
from elast_cli.evaluation.statistics import wilson
from elast_cli.evaluation.summary import parse_results, pooled, results_document, summarize
from tests.toys.episodes import ROWS, episode


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
        (damaged(train_seed=1), "appears twice"),
        (damaged(extra=1), r"per_episode\.0\.extra"),
    ],
)
def test_a_damaged_document_is_refused_in_one_line(document: Any, message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        parse_results(document)
    assert "\n" not in str(caught.value)
