"""`elast envs` and `elast methods`: the names that flags accept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from elast_cli.config import JsonDict
from elast_cli.envs.registry import names, spec
from elast_cli.methods.table import METHODS

if TYPE_CHECKING:
    from rich.table import Table


def environments() -> list[JsonDict]:
    """One row an environment, those of other packages included; none is made for it."""
    return [
        {
            "name": entry.name,
            "about": entry.about,
            "max_steps": entry.max_episode_steps,
            "gymnasium": entry.gym_id,
        }
        for entry in map(spec, names())
    ]


def methods() -> list[JsonDict]:
    """One row a method: what it is, and the learned parts that it needs."""
    return [
        {"name": method.name, "about": method.about, "parts": list(method.parts)}
        for method in METHODS.values()
    ]


def environments_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The environments for people."""
    return _table(("environment", "what it is", "steps"), rows, ("name", "about", "max_steps"))


def methods_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The methods for people."""
    shown = [{**row, "parts": ", ".join(row["parts"]) or "none"} for row in rows]
    return _table(("method", "what it is", "learned parts"), shown, ("name", "about", "parts"))


def _table(headers: Sequence[str], rows: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for header in headers:
        table.add_column(header)
    for row in rows:
        table.add_row(*("-" if row[key] is None else str(row[key]) for key in keys))
    return table
