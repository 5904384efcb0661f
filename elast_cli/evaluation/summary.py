"""From episode rows to success rates with intervals, and the results document. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from pydantic import JsonValue, ValidationError

from elast_cli.errors import DataError
from elast_cli.evaluation.rows import SCHEMA_VERSION, Cell, EpisodeRow, K, OverallRow, Results, T
from elast_cli.evaluation.statistics import mean, standard_deviation, wilson


def summarize(rows: Sequence[EpisodeRow]) -> list[OverallRow]:
    """One row per training seed, then the pooled row, for each cell in order of appearance.

    Raises:
        DataError: an episode appears twice.
    """
    require_unique(rows)
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
    require_unique(results.per_episode)
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


def grouped(items: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """The items by key, keys and items in order of appearance."""
    groups: dict[K, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def cell_of(row: EpisodeRow | OverallRow) -> Cell:
    """The table cell a row belongs to."""
    return Cell(row.env, row.level, row.method)


def require_unique(rows: Sequence[EpisodeRow]) -> None:
    """Check that every episode is there once.

    Raises:
        DataError: an episode of a cell and training seed appears twice.
    """
    seen: set[tuple[Cell, int, int, int]] = set()
    for row in rows:
        key = (cell_of(row), row.train_seed, row.episode_ix, row.seed)
        if key in seen:
            raise DataError(
                f"results: episode {row.episode_ix} of {row.method} on {row.env}/{row.level}, "
                f"train_seed {row.train_seed}, seed {row.seed}, appears twice"
            )
        seen.add(key)
