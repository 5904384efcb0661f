"""Two evaluations side by side: paired differences with intervals. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.errors import DataError
from elast_cli.evaluation.rows import EpisodeRow, Interval, Percent
from elast_cli.evaluation.statistics import mcnemar_exact, mean, newcombe_paired, t_interval
from elast_cli.evaluation.summary import grouped, require_unique
from elast_cli.evaluation.tables import empty_table, number

if TYPE_CHECKING:
    from rich.table import Table


class Comparison(StrictModel):
    """Evaluation B against A on the scenarios both ran; every difference is B minus A."""

    env: str
    level: str
    method_a: str
    method_b: str
    train_seed: int | None  # None: all training seeds pooled
    n_pairs: int = Field(ge=1)
    unpaired_a: int = Field(ge=0)
    unpaired_b: int = Field(ge=0)
    pc_success_a: Percent
    pc_success_b: Percent
    difference: float  # percentage points
    ci95: Interval  # Newcombe's paired score interval
    only_a: int = Field(ge=0)  # solved by A alone
    only_b: int = Field(ge=0)
    mcnemar_p: float = Field(ge=0, le=1)
    both: int = Field(ge=0)
    steps_difference: float | None  # mean over pairs that both solved
    steps_ci95: Interval | None  # Student t


def compare(rows_a: Sequence[EpisodeRow], rows_b: Sequence[EpisodeRow]) -> list[Comparison]:
    """B minus A on equal (env, level, train_seed, episode_ix, seed), per training seed and pooled.

    Each method both hold is compared with itself; where they share none and each holds a single
    one, these two are compared.

    Raises:
        DataError: an episode appears twice, or nothing pairs.
    """
    require_unique(rows_a)
    require_unique(rows_b)
    found = []
    for method_a, method_b in _method_pairs(rows_a, rows_b):
        in_a = {_pairing_key(row): row for row in rows_a if row.method == method_a}
        in_b = {_pairing_key(row): row for row in rows_b if row.method == method_b}
        cells = dict.fromkeys((key[0], key[1]) for key in in_a if key in in_b)
        for cell in cells:
            of_a = [row for key, row in in_a.items() if key[:2] == cell]
            of_b = [row for key, row in in_b.items() if key[:2] == cell]
            found += _comparisons(of_a, of_b)
    if not found:
        raise DataError(
            "nothing to compare: no (env, level, train_seed, episode_ix, seed) is in both "
            f"evaluations; A has {_described(rows_a)}; B has {_described(rows_b)}; "
            "evaluate both with the same --seeds, --episodes and --scenario-seed"
        )
    return found


def _comparisons(rows_a: Sequence[EpisodeRow], rows_b: Sequence[EpisodeRow]) -> list[Comparison]:
    """The comparisons of one cell: one per training seed that pairs, then the pooled one."""
    in_b = {_pairing_key(row): row for row in rows_b}
    pairs = [(row, in_b[key]) for row in rows_a if (key := _pairing_key(row)) in in_b]
    by_seed = dict(sorted(grouped(pairs, lambda pair: pair[0].train_seed).items()))
    found = []
    for seed, of_seed in by_seed.items():
        total_a = sum(row.train_seed == seed for row in rows_a)
        total_b = sum(row.train_seed == seed for row in rows_b)
        found.append(_comparison(of_seed, train_seed=seed, total_a=total_a, total_b=total_b))
    total = _comparison(pairs, train_seed=None, total_a=len(rows_a), total_b=len(rows_b))
    return [*found, total]


def _comparison(
    pairs: Sequence[tuple[EpisodeRow, EpisodeRow]],
    *,
    train_seed: int | None,
    total_a: int,
    total_b: int,
) -> Comparison:
    n = len(pairs)
    both = sum(a.success and b.success for a, b in pairs)
    only_a = sum(a.success and not b.success for a, b in pairs)
    only_b = sum(b.success and not a.success for a, b in pairs)
    steps = [
        float(b.steps - a.steps) for a, b in pairs if a.steps is not None and b.steps is not None
    ]
    first_a, first_b = pairs[0]
    return Comparison(
        env=first_a.env,
        level=first_a.level,
        method_a=first_a.method,
        method_b=first_b.method,
        train_seed=train_seed,
        n_pairs=n,
        unpaired_a=total_a - n,
        unpaired_b=total_b - n,
        pc_success_a=100.0 * (both + only_a) / n,
        pc_success_b=100.0 * (both + only_b) / n,
        difference=100.0 * (only_b - only_a) / n,
        ci95=newcombe_paired(both, only_a, only_b, n - both - only_a - only_b),
        only_a=only_a,
        only_b=only_b,
        mcnemar_p=mcnemar_exact(only_a, only_b),
        both=both,
        steps_difference=mean(steps),
        steps_ci95=t_interval(steps),
    )


def _method_pairs(
    rows_a: Sequence[EpisodeRow], rows_b: Sequence[EpisodeRow]
) -> list[tuple[str, str]]:
    methods_a = list(dict.fromkeys(row.method for row in rows_a))
    methods_b = list(dict.fromkeys(row.method for row in rows_b))
    shared = [(method, method) for method in methods_a if method in methods_b]
    if shared or len(methods_a) != 1 or len(methods_b) != 1:
        return shared
    return [(methods_a[0], methods_b[0])]


def _pairing_key(row: EpisodeRow) -> tuple[str, str, int, int, int]:
    return row.env, row.level, row.train_seed, row.episode_ix, row.seed


def _described(rows: Sequence[EpisodeRow]) -> str:
    """What an evaluation holds, on one line."""
    parts = []
    for (env, level), of_task in grouped(rows, lambda row: (row.env, row.level)).items():
        methods = ",".join(dict.fromkeys(row.method for row in of_task))
        seeds = ",".join(map(str, sorted({row.train_seed for row in of_task})))
        parts.append(f"{methods}@{env}/{level} of train_seed {seeds}")
    return " and ".join(parts) or "no episode"


def comparison_table(comparisons: Sequence[Comparison]) -> Table:
    """The pooled comparisons for people; every difference is B minus A."""
    numbers = ["A %", "B %", "B - A", "95 %\ninterval", "only A\n/ only B", "McNemar\np"]
    shown = empty_table(["task", "method"], [*numbers, "steps\nB - A", "95 %\ninterval", "pairs"])
    for row in comparisons:
        if row.train_seed is None:
            shown.add_row(*_comparison_cells(row))
    return shown


def _comparison_cells(row: Comparison) -> list[str]:
    same = row.method_a == row.method_b
    return [
        f"{row.env} {row.level}",
        row.method_a if same else f"{row.method_a} -> {row.method_b}",
        number(row.pc_success_a),
        number(row.pc_success_b),
        f"{row.difference:+.1f}",
        signed(row.ci95),
        f"{row.only_a} / {row.only_b}",
        p_text(row.mcnemar_p),
        "-" if row.steps_difference is None else f"{row.steps_difference:+.1f}",
        "-" if row.steps_ci95 is None else signed(row.steps_ci95),
        str(row.n_pairs),
    ]


def p_text(p: float) -> str:
    """A p-value with three decimals."""
    return f"{p:.3f}" if p >= 0.001 else "< 0.001"


def signed(interval: tuple[float, float]) -> str:
    """An interval of differences."""
    return f"[{interval[0]:+.1f}, {interval[1]:+.1f}]"
