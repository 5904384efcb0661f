"""The table for people."""

from __future__ import annotations

import io

from rich.console import Console

from elast_cli.evaluation.summary import summarize
from elast_cli.evaluation.tables import success_notes, table
from tests.toys.episodes import ROWS, episode


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


def test_what_decides_success_is_told_once_for_each_environment_that_says_it() -> None:
    outside = {"env": {"id": "Room-v0"}, "success": "the image is near"}
    own = {"env": {"half_size": 0.1}}
    assert success_notes([own, outside, outside]) == ["success in Room-v0: the image is near"]
