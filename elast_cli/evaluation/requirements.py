"""`--require`: bounds on success rates, so that a script or CI can act on an evaluation."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from elast_cli.config import StrictModel
from elast_cli.errors import UsageError, suggestion
from elast_cli.evaluation.rows import Cell, OverallRow, Percent
from elast_cli.evaluation.summary import cell_of, pooled

_RELATIONS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
_REQUIREMENT = re.compile(
    r"(?P<method>[\w-]+)(?:@(?P<env>[\w-]+)(?:/(?P<level>[\w-]+))?)?"
    r"\s*(?P<relation>>=|<=|>|<)\s*(?P<bound>\d+(?:\.\d+)?)\s*%?",
    re.ASCII,
)


class Requirement(StrictModel):
    """A bound on the success rate, as `--require` states it."""

    text: str
    method: str
    env: str | None
    level: str | None
    relation: str
    bound: Percent

    def holds(self, pc_success: float) -> bool:
        """Whether a success rate in percent meets the bound."""
        return _RELATIONS[self.relation](pc_success, self.bound)

    def covers(self, cell: Cell) -> bool:
        """Whether the bound covers this (env, level, method)."""
        return (
            cell.method == self.method
            and self.env in (None, cell.env)
            and self.level in (None, cell.level)
        )


class Verdict(NamedTuple):
    """A requirement against one pooled row."""

    text: str
    value: float
    ok: bool


def parse_requirement(text: str) -> Requirement:
    """The bound that `text` states, such as `elast>=90` or `elast@block-s/hard>=93`.

    Raises:
        UsageError: not of that form, or the bound is no percentage.
    """
    match = _REQUIREMENT.fullmatch(text.strip())
    if match is None or not 0.0 <= float(match["bound"]) <= 100.0:
        raise UsageError(
            f"bad requirement {text!r}: expected METHOD[@ENV[/LEVEL]] followed by >=, <=, > or < "
            "and a percentage from 0 to 100, e.g. --require 'elast@block-s/hard>=93'"
        )
    return Requirement(
        text=text.strip(),
        method=match["method"],
        env=match["env"],
        level=match["level"],
        relation=match["relation"],
        bound=float(match["bound"]),
    )


def expect(requirements: Iterable[Requirement], cells: Iterable[Cell]) -> None:
    """Check that each requirement covers a cell; made before an evaluation starts.

    Raises:
        UsageError: a requirement that no cell could ever meet or miss.
    """
    known = list(dict.fromkeys(cells))
    for requirement in requirements:
        if any(requirement.covers(cell) for cell in known):
            continue
        names = [f"{cell.method}@{cell.env}/{cell.level}" for cell in known]
        wanted = re.split(r"\s*[<>]", requirement.text)[0]
        hint = suggestion(wanted, [*names, *(c.method for c in known)])
        raise UsageError(
            f"requirement {requirement.text!r} matches nothing that is evaluated{hint}; "
            f"there is: {', '.join(names) or 'nothing'}"
        )


def check(requirements: Sequence[Requirement], overall: Sequence[OverallRow]) -> list[Verdict]:
    """Each requirement against every pooled row it covers.

    Raises:
        UsageError: a requirement covers no row; a misspelt one must not pass.
    """
    rows = {cell_of(row): row for row in pooled(overall)}
    expect(requirements, rows)
    return [
        Verdict(
            text=f"{requirement.text}: {cell.method}@{cell.env}/{cell.level}",
            value=row.pc_success,
            ok=requirement.holds(row.pc_success),
        )
        for requirement in requirements
        for cell, row in rows.items()
        if requirement.covers(cell)
    ]
