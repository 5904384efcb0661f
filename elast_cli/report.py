"""From episode rows to tables, verdicts and paired differences. Pure: reads and writes no file.

A success rate always comes with its Wilson 95 % interval. Rows of several training seeds are given
one by one and pooled; the pooled interval is over scenarios, so the spread between training seeds
stands beside it (`pc_success_by_seed`, `pc_success_std`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, NamedTuple, Self, TypeVar

from pydantic import Field, JsonValue, ValidationError, model_validator

from elast_cli.config import StrictModel
from elast_cli.errors import DataError
from elast_cli.statistics import mean, standard_deviation, wilson

if TYPE_CHECKING:
    from rich.table import Table

SCHEMA_VERSION = 1

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)

Interval = Annotated[tuple[float, float], Field(strict=False)]  # JSON has lists only
Percent = Annotated[float, Field(ge=0, le=100)]


class Cell(NamedTuple):
    """One cell of a results table."""

    env: str
    level: str
    method: str


class EpisodeRow(StrictModel):
    """One evaluated episode."""

    env: str
    level: str
    method: str
    train_seed: int
    episode_ix: int = Field(ge=0)
    seed: int  # of the scenario
    success: bool  # inside the success radius at some step
    steps: int | None = Field(ge=0)  # to the first success; None where there is none
    shortest: int | None = Field(ge=0)  # optimal steps to the edge of the success region
    plans: int = Field(ge=0)
    plan_s: float = Field(ge=0)  # mean wall seconds a plan; 0 where nothing plans
    first_plan_s: float = Field(default=0.0, ge=0)  # of the episode's first plan
    reached: int = Field(default=0, ge=0)  # plans whose path ended within the goal radius
    density_calls_per_step: float = Field(default=0.0, ge=0)  # evaluations of ψ
    policy_calls_per_step: float = Field(default=0.0, ge=0)  # evaluations of π
    network_calls_per_step: float = Field(ge=0)
    held: bool  # still inside the radius at the end

    @model_validator(mode="after")
    def _steps_belong_to_a_success(self) -> Self:
        if self.success != (self.steps is not None):
            raise ValueError("steps is a number where success is true, and null elsewhere")
        if self.held and not self.success:
            raise ValueError("held is true only where success is")
        return self


class OverallRow(StrictModel):
    """The episodes of one (env, level, method): of one training seed, or of all of them."""

    env: str
    level: str
    method: str
    train_seed: int | None  # None: all training seeds pooled
    n_episodes: int = Field(ge=1)
    pc_success: Percent
    ci95: Interval  # Wilson, over episodes
    pc_held: Percent
    steps: float | None  # mean over successes
    steps_over_shortest: float | None  # mean ratio over successes
    plan_s: float | None  # mean over plans
    network_calls_per_step: float
    pc_success_by_seed: dict[str, float] | None = None  # pooled rows only
    pc_success_std: float | None = None  # between training seeds, two or more


class Results(StrictModel):
    """The results document: what an evaluation publishes as JSON."""

    schema_version: int = Field(ge=1)
    overall: list[OverallRow]
    per_episode: list[EpisodeRow]
    lineage: dict[str, JsonValue]
    settings: dict[str, JsonValue]


def summarize(rows: Sequence[EpisodeRow]) -> list[OverallRow]:
    """One row per training seed, then the pooled row, for each cell in order of appearance.

    Raises:
        DataError: an episode appears twice.
    """
    refuse_twins(rows)
    overall = []
    for cell, cell_rows in grouped(rows, cell_of).items():
        by_seed = dict(sorted(grouped(cell_rows, lambda row: row.train_seed).items()))
        seeds = [_summary(cell, seed, of_seed) for seed, of_seed in by_seed.items()]
        rates = [row.pc_success for row in seeds]
        pooled = _summary(cell, None, cell_rows).model_copy(
            update={
                "pc_success_by_seed": {str(row.train_seed): row.pc_success for row in seeds},
                "pc_success_std": standard_deviation(rates),
            }
        )
        overall += [*seeds, pooled]
    return overall


def pooled(overall: Iterable[OverallRow]) -> list[OverallRow]:
    """The rows over all training seeds."""
    return [row for row in overall if row.train_seed is None]


def _summary(cell: Cell, train_seed: int | None, rows: Sequence[EpisodeRow]) -> OverallRow:
    n = len(rows)
    solved = [row for row in rows if row.success]
    plans = sum(row.plans for row in rows)
    seconds = math.fsum(row.plan_s * row.plans for row in rows)
    calls = mean([row.network_calls_per_step for row in rows])
    ratios = [row.steps / row.shortest for row in solved if row.steps is not None and row.shortest]
    return OverallRow(
        env=cell.env,
        level=cell.level,
        method=cell.method,
        train_seed=train_seed,
        n_episodes=n,
        pc_success=100.0 * len(solved) / n,
        ci95=wilson(len(solved), n),
        pc_held=100.0 * sum(row.held for row in rows) / n,
        steps=mean([row.steps for row in solved if row.steps is not None]),
        steps_over_shortest=mean(ratios),
        plan_s=seconds / plans if plans else None,
        network_calls_per_step=calls or 0.0,
    )


def results_document(
    rows: Sequence[EpisodeRow], lineage: Mapping[str, object], settings: Mapping[str, object]
) -> dict[str, JsonValue]:
    """The results as plain JSON data; a NaN or an infinity in `lineage` or `settings` is null."""
    document: dict[str, JsonValue] = {
        "schema_version": SCHEMA_VERSION,
        "overall": [row.model_dump(mode="json") for row in summarize(rows)],
        "per_episode": [row.model_dump(mode="json") for row in rows],
        "lineage": _plain(lineage),
        "settings": _plain(settings),
    }
    return document


def parse_results(document: object) -> Results:
    """The results document, checked field by field.

    Raises:
        DataError: of a newer schema, or a field is missing, unknown or wrong; it names the field.
    """
    if not isinstance(document, dict):
        raise DataError(f"results: expected a JSON object, got {type(document).__name__}")
    version = document.get("schema_version")
    if isinstance(version, int) and version > SCHEMA_VERSION:
        raise DataError(
            f"results: schema_version {version} is newer than {SCHEMA_VERSION}, the newest this "
            "elast reads; upgrade with: pip install --upgrade elast"
        )
    try:
        results = Results.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "results"
        raise DataError(f"results: {field}: {first['msg']}, got {first['input']!r:.80}") from None
    refuse_twins(results.per_episode)
    return results


def _plain(value: object) -> JsonValue:
    """`value` as JSON data: mappings to objects, sequences to lists, other things to their text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


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


def grouped(items: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """The items by key, keys and items in order of appearance."""
    groups: dict[K, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def cell_of(row: EpisodeRow | OverallRow) -> Cell:
    """The table cell a row belongs to."""
    return Cell(row.env, row.level, row.method)


def refuse_twins(rows: Sequence[EpisodeRow]) -> None:
    """Nothing if every episode is there once.

    Raises:
        DataError: an episode of a cell and training seed appears twice.
    """
    seen: set[tuple[Cell, int, int, int]] = set()
    for row in rows:
        key = (cell_of(row), row.train_seed, row.episode_ix, row.seed)
        if key in seen:
            raise DataError(
                f"results: episode {row.episode_ix} of {row.method} on {row.env}/{row.level}, "
                f"train_seed {row.train_seed}, seed {row.seed}, is there twice"
            )
        seen.add(key)


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
