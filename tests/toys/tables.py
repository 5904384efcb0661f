"""The tables of parts and of methods, put back after rows were added."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from elast_cli.methods.table import METHODS
from elast_cli.models.parts import PARTS


@contextmanager
def kept_tables() -> Iterator[None]:
    """Both tables are afterwards as they were."""
    kept: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (table, dict(table)) for table in (PARTS, METHODS)
    ]
    try:
        yield
    finally:
        for table, rows in kept:
            table.clear()
            table.update(rows)
