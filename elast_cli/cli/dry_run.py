"""Dry runs: what would be made, and what it would take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from elast_cli.cli.meter import duration
from elast_cli.cli.output import print_json, print_text
from elast_cli.stages.estimate import total
from elast_cli.stages.inspect import size_text

Row = Mapping[str, Any]


def show_stage(plan: Row, *, json: bool) -> None:
    """Print what a single stage would do."""
    print_json(plan) if json else print_text(_stage(plan))


def show_chain(rows: Sequence[Row], *, json: bool) -> None:
    """Print what a chain of stages would find and make, and what all of it would take."""
    if json:
        print_json({"artifacts": rows, "total": total(rows)})
    else:
        print_text("\n".join([*map(_line, rows), _total(total(rows))]))


def _stage(plan: Row) -> str:
    if plan["published"]:
        return f"{plan['published']} already exists"
    inputs = ", ".join(plan["inputs"].values())
    made = f"would make {plan['env']}/{plan['kind']}" + (f" from {inputs}" if inputs else "")
    return f"{made}: {_cost(plan)}"


def _line(row: Row) -> str:
    state = f"exists: {row['published']}" if row["published"] else f"to make: {_cost(row)}"
    return f"{row['env']}  seed {row['seed']}  {row['kind']!s:<16} {state}"


def _cost(row: Row) -> str:
    """What an artifact would take, and the source of the estimate."""
    size, memory, seconds = (row[key] for key in ("disk_bytes", "memory_bytes", "seconds"))
    return (
        f"disk {_known(size, size_text, row['disk_from'])}, memory {_known(memory, size_text)}, "
        f"time {_known(seconds, duration, row['seconds_from'])}"
    )


def _known(value: Any, text: Any, source: str = "") -> str:
    if value is None:
        return "unknown"
    return f"{text(value)} ({source})" if source else str(text(value))


def _total(found: Row) -> str:
    """All rows together."""
    bound = "" if found["complete"] else "at least "
    size, seconds = size_text(found["disk_bytes"]), duration(found["seconds"])
    return f"total: disk {bound}{size}, time {bound}{seconds}, one after another"
