"""Bounds on success rates."""

from __future__ import annotations

import pytest

from elast_cli.errors import UsageError
from elast_cli.evaluation.requirements import check, expect, parse_requirement
from elast_cli.evaluation.rows import Cell, OverallRow


def overall(
    method: str,
    pc_success: float,
    *,
    env: str = "block-s",
    level: str = "hard",
    train_seed: int | None = None,
) -> OverallRow:
    return OverallRow(
        env=env,
        level=level,
        method=method,
        train_seed=train_seed,
        n_episodes=100,
        pc_success=pc_success,
        ci95=(0.0, 100.0),
        pc_held=0.0,
        steps=None,
        steps_over_shortest=None,
        plan_s=None,
        network_calls_per_step=0.0,
    )


OVERALL = [
    overall("elast", 10.0, train_seed=0),
    overall("elast", 95.0),
    overall("elast", 80.0, level="medium"),
    overall("cpc-cem", 30.0),
]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("elast>=90", [95.0, 80.0]),
        ("elast@block-s>=90", [95.0, 80.0]),
        ("elast@block-s/hard >= 95", [95.0]),
        ("cpc-cem<=30%", [30.0]),
    ],
)
def test_a_requirement_covers_every_matching_pooled_row(text: str, values: list[float]) -> None:
    assert [verdict.value for verdict in check([parse_requirement(text)], OVERALL)] == values


@pytest.mark.parametrize(
    ("text", "ok"),
    [
        ("elast@block-s/hard>=95", True),
        ("elast@block-s/hard>95", False),
        ("elast@block-s/hard>95.5", False),
        ("cpc-cem<=30", True),
        ("cpc-cem<30", False),
    ],
)
def test_a_bound_is_met_or_missed_at_its_edge(text: str, ok: bool) -> None:
    verdict = check([parse_requirement(text)], OVERALL)[0]
    assert verdict.ok is ok
    assert verdict.text.startswith(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "elast",
        "elast=90",
        "elast>=",
        "elast>=-1",
        "elast>=101",
        "elast@>=3",
        "elast@a/b/c>=3",
        "elast>=nan",
        "elast>=1e1",
        ">=90",
        "elast>=" + "9" * 400,
    ],
)
def test_a_bad_requirement_is_answered_with_the_form(text: str) -> None:
    with pytest.raises(UsageError, match=r"METHOD\[@ENV\[/LEVEL\]\]"):
        parse_requirement(text)


def test_a_misspelt_requirement_does_not_pass_silently() -> None:
    with pytest.raises(UsageError, match=r"elats>=90.*did you mean 'elast'.*elast@block-s/hard"):
        check([parse_requirement("elats>=90")], OVERALL)


def test_a_requirement_can_be_checked_before_anything_runs() -> None:
    cells = [Cell("block-s", "hard", "elast")]
    expect([parse_requirement("elast@block-s>=1")], cells)
    with pytest.raises(UsageError, match="matches nothing"):
        expect([parse_requirement("elast@block-s/medium>=1")], cells)
