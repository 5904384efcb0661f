"""The paper's figures: all of Table 1, and what its text says of ablations."""

from __future__ import annotations

import pytest

from elast_cli.envs.registry import ENVS, task_info
from elast_cli.evaluation.paper import (
    _TABLE,
    ABLATIONS,
    COLUMNS,
    METHODS,
    paper_ablation,
    paper_rate,
    paper_success,
)


def test_there_are_eight_methods_and_eleven_columns_without_a_gap() -> None:
    assert (len(METHODS), len(COLUMNS)) == (8, 11)
    for method in METHODS:
        assert len(_TABLE[method].split()) == len(COLUMNS)
        rates = [paper_rate(method, column.env, column.level) for column in COLUMNS]
        assert all(rate and 0 <= rate.mean <= 100 and rate.deviation >= 0 for rate in rates)


def test_the_columns_are_tasks_and_levels_of_elast() -> None:
    assert {column.env for column in COLUMNS} <= set(ENVS)
    for column in COLUMNS:
        assert column.level in task_info(column.env).levels


@pytest.mark.parametrize(
    ("method", "env", "level", "success"),
    [
        ("elast", "block-s", "hard", 96),
        ("elast", "cable-param", "standard", 79),
        ("cpc-cem", "block-asym", "upstream", 21),
        ("planet", "block-s", "medium", 17),
        ("v-gcbc", "button", "standard", 81),
        ("htm", "planar-arm", "standard", 43),
        ("random", "cable", "standard", 8),
    ],
)
def test_a_figure_of_the_table(method: str, env: str, level: str, success: float) -> None:
    assert paper_success(method, env, level) == success


def test_what_the_paper_has_not_is_none() -> None:
    assert paper_success("elast-psi", "block-s", "hard") is None
    assert paper_success("elast", "block-s", "easy") is None
    assert paper_ablation("no-rewire", "cable", "standard") is None


def test_ablations_start_from_table_1() -> None:
    for row in ABLATIONS:
        assert row.success[0] == paper_success("elast", row.env, row.level)
    found = paper_ablation("no-rewire", "block-s", "hard")
    assert str(found) == "96 → 40, 36 → 93 steps"
    assert str(paper_ablation("no-density", "cable", "standard")) == "95 → 25"
