"""Ablations: each change of a method against the method as it is, on the same scenarios. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elast_cli.evaluation.comparison import Comparison, compare, p_text, signed
from elast_cli.evaluation.documents import markdown_table, success_record, success_text
from elast_cli.evaluation.paper import SOURCE, paper_ablation
from elast_cli.evaluation.rows import EpisodeRow, OverallRow
from elast_cli.evaluation.summary import pooled, summarize
from elast_cli.evaluation.tables import number


@dataclass(frozen=True)
class Line:
    """One change of one method at a level.

    Attributes:
        base: the method that is changed.
        label: the change.
        env, level: where.
        overall: success with the change; None where its evaluation failed.
        against: compared with the method as it is, over all training seeds; None for that itself.
        paper: what the paper says of it, or nothing.
    """

    base: str
    label: str
    env: str
    level: str
    overall: OverallRow | None
    against: Comparison | None
    paper: str

    def record(self, preset: str) -> dict[str, object]:
        """As a record, for CSV and JSON."""
        low, high = self.against.ci95 if self.against else (None, None)
        return {
            "method": self.base,
            "change": self.label,
            "env": self.env,
            "level": self.level,
            "preset": preset,
            **success_record(self.overall),
            "difference": self.against.difference if self.against else None,
            "difference_low": low,
            "difference_high": high,
            "mcnemar_p": self.against.mcnemar_p if self.against else None,
            "steps_difference": self.against.steps_difference if self.against else None,
            "paper": self.paper,
        }

    @property
    def cells(self) -> list[str]:
        """As texts, in the order of the table's columns."""
        row, against = self.overall, self.against
        return [
            f"`{self.base}`",
            self.label,
            self.level,
            success_text(row) if row else "failed",
            number(row.steps) if row else "-",
            f"{against.difference:+.1f} {signed(against.ci95)}" if against else "-",
            p_text(against.mcnemar_p) if against else "-",
            _signed_number(against.steps_difference) if against else "-",
            self.paper or "-",
        ]


def line(
    base: str,
    label: str,
    where: tuple[str, str],
    rows: Sequence[EpisodeRow],
    of_base: Sequence[EpisodeRow],
    paper: str = "",
) -> Line:
    """A line of the table, from episodes.

    Args:
        base: the method that is changed.
        label: the change.
        where: environment and level.
        rows: episodes with the change, none where it failed.
        of_base: episodes of the method as it is, none for that itself or where it failed.
        paper: what the paper calls the change.
    """
    overall = pooled(summarize(rows))[0] if rows else None
    shared = {row.train_seed for row in rows} & {row.train_seed for row in of_base}
    against = compare(of_base, rows)[-1] if shared else None
    known = paper_ablation(paper, *where) if paper else None
    return Line(base, label, *where, overall, against, str(known) if known else "")


def markdown(lines: Sequence[Line], env: str, preset: str, seeds: Sequence[int]) -> str:
    """The table for people."""
    about = (
        f"Preset `{preset}`, training seeds {', '.join(map(str, seeds))}. Success in % with Wilson "
        "95 % intervals. A change is the difference to the method as it is on the same scenarios, "
        "in points, with Newcombe's paired 95 % interval and McNemar's exact test. Steps are those "
        f"of successes; their change is on scenarios that both solve. Paper: {SOURCE}."
    )
    headers = ["method", "change", "level", "success", "steps", "difference", "McNemar p"]
    headers += ["steps, difference", "the paper's"]
    rows = [line.cells for line in lines]
    return f"# Ablations on {env}\n\n{about}\n\n{markdown_table(headers, rows)}\n"


def _signed_number(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f}"
