"""Table 1: success of methods by task beside the paper's, with costs. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elast_cli.evaluation.documents import markdown_table, success_record, success_text
from elast_cli.evaluation.paper import COLUMNS, SOURCE, Column, Rate
from elast_cli.evaluation.rows import OverallRow
from elast_cli.evaluation.summary import grouped
from elast_cli.evaluation.tables import number

NOT_RUN = "not run"


@dataclass(frozen=True)
class Costs:
    """What a method takes in a task; None where it is unknown.

    Attributes:
        cpu_s_per_step: CPU seconds of an environment step, simulation included.
        training_minutes: of all parts of one seed, mean over seeds.
        peak_memory_gb: most memory of a process that trained a part.
        parameters: trained numbers of all parts.
    """

    cpu_s_per_step: float | None = None
    training_minutes: float | None = None
    peak_memory_gb: float | None = None
    parameters: int | None = None


@dataclass(frozen=True)
class Entry:
    """A method in a task at a level.

    Attributes:
        method: its name.
        column: the task and level.
        paper: the paper's figure, where it has one.
        overall: success over all training seeds; None where nothing was evaluated.
        costs: what it takes.
        commits: of elast that evaluated.
        refs: the evaluations.
    """

    method: str
    column: Column
    paper: Rate | None
    overall: OverallRow | None = None
    costs: Costs = Costs()
    commits: tuple[str, ...] = ()
    refs: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The cell for people."""
        own = success_text(self.overall) if self.overall else NOT_RUN
        return f"{own}; paper {self.paper.mean:g} ± {self.paper.deviation:g}" if self.paper else own

    def record(self, preset: str) -> dict[str, object]:
        """The cell as a record, for CSV and JSON."""
        return {
            "method": self.method,
            "env": self.column.env,
            "level": self.column.level,
            "preset": preset,
            **success_record(self.overall),
            "paper_success": self.paper.mean if self.paper else None,
            "paper_deviation": self.paper.deviation if self.paper else None,
            **vars(self.costs),
            "commits": " ".join(self.commits),
            "evaluations": " ".join(self.refs),
            "status": "run" if self.overall else NOT_RUN,
        }


def markdown(entries: Sequence[Entry], preset: str, seeds: Sequence[int]) -> str:
    """Both tables for people: success, and costs."""
    commits = sorted({commit for entry in entries for commit in entry.commits})
    about = (
        f"Preset `{preset}`, training seeds {', '.join(map(str, seeds))}. "
        f"Success in % with Wilson 95 % intervals over all episodes, and by training seed. "
        f"Paper: {SOURCE}, Table 1. Evaluated at: {', '.join(commits) or 'an unknown commit'}."
    )
    return "\n\n".join(["# Table 1", about, _success(entries), "## Costs", _costs(entries)]) + "\n"


def _success(entries: Sequence[Entry]) -> str:
    columns = [c for c in COLUMNS if any(entry.column == c for entry in entries)]
    by_method = grouped(entries, lambda entry: entry.method)
    rows = [
        [f"`{method}`", *({e.column: e.text for e in of}.get(c, NOT_RUN) for c in columns)]
        for method, of in by_method.items()
    ]
    return markdown_table(["method", *(column.title for column in columns)], rows)


def _costs(entries: Sequence[Entry]) -> str:
    headers = ["method", "task", "parameters", "training, min", "peak memory, GB", "CPU s a step"]
    rows = [
        [
            f"`{entry.method}`",
            entry.column.title,
            "-" if entry.costs.parameters is None else f"{entry.costs.parameters:,}",
            number(entry.costs.training_minutes),
            number(entry.costs.peak_memory_gb, 2),
            number(entry.costs.cpu_s_per_step, 3),
        ]
        for entry in entries
        if entry.overall
    ]
    return markdown_table(headers, rows) if rows else "Nothing was evaluated yet."
