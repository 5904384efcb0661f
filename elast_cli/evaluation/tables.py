"""Results tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from elast_cli.evaluation.rows import OverallRow
from elast_cli.evaluation.summary import grouped, pooled

if TYPE_CHECKING:
    from rich.table import Table


def table(overall: Sequence[OverallRow]) -> Table:
    """The pooled rows for people: a section per (env, level), a line per method."""
    rows = pooled(overall)
    several_seeds = any(len(row.pc_success_by_seed or {}) > 1 for row in rows)
    numbers = ["success\n%", "95 %\ninterval", "steps", "steps /\nshortest", "plan\ns"]
    numbers += ["calls\n/ step", "episodes"]
    shown = empty_table(["task", "method"], [*numbers, *["success %\nby seed"] * several_seeds])
    for (env, level), of_task in grouped(rows, lambda row: (row.env, row.level)).items():
        for index, row in enumerate(of_task):
            task = f"{env} {level}" if index == 0 else ""
            by_seed = " ".join(f"{rate:.0f}" for rate in (row.pc_success_by_seed or {}).values())
            cells = [task, row.method, *_figures(row), *[by_seed] * several_seeds]
            shown.add_row(*cells, end_section=row is of_task[-1])
    return shown


def success_notes(settings: Iterable[Mapping[str, object]]) -> list[str]:
    """What decides success, a line for each environment that says so in its settings.

    Args:
        settings: those of evaluations or reports.
    """
    told = [(found.get("success"), found.get("env")) for found in settings]
    notes = [
        f"success in {env['id']}: {text}"
        for text, env in told
        if isinstance(text, str) and isinstance(env, Mapping) and "id" in env
    ]
    return list(dict.fromkeys(notes))


def empty_table(names: Sequence[str], numbers: Sequence[str]) -> Table:
    """A table with text columns, then number columns: narrow, and plain when it is piped."""
    from rich import box
    from rich.table import Table

    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for name in names:
        shown.add_column(name, no_wrap=True, vertical="bottom")
    for name in numbers:
        shown.add_column(name, justify="right", no_wrap=True, vertical="bottom")
    return shown


def number(value: float | None, digits: int = 1) -> str:
    """`value` with so many decimals, a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def _figures(row: OverallRow) -> list[str]:
    """A row's numbers as text, in the order of the table's columns."""
    low, high = row.ci95
    return [
        number(row.pc_success),
        f"[{low:.1f}, {high:.1f}]",
        number(row.steps),
        number(row.steps_over_shortest, 2),
        number(row.plan_s, 2),
        f"{row.network_calls_per_step:,.0f}",
        str(row.n_episodes),
    ]
