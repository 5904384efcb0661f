"""`elast ablate`: variations of methods, evaluated and compared with the methods as they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from elast_cli.evaluation import ablations
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.stages import wanted
from elast_cli.stages.benchmark import Benchmark
from elast_cli.stages.job import Job
from elast_cli.stages.sweeps import BASE, Variation, varied
from elast_cli.stages.wanted import Wanted
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store


@dataclass(frozen=True)
class Case:
    """A variation of a method, and its evaluation for each training seed."""

    base: str
    variation: Variation
    evaluations: tuple[Wanted, ...]


def cases(job: Job, bench: Benchmark, variations: Sequence[Variation]) -> list[Case]:
    """Each method as it is, then each of its variations; a switch that it lacks is left out.

    Raises:
        UsageError: a variation has no effect on a method.
        ConfigError: a variation is no valid configuration.
    """
    return [
        Case(base, variation, tuple(_evaluations(job, bench, base, variation)))
        for base in bench.methods
        for variation in (BASE, *variations)
        if variation.method(base)
    ]


def _evaluations(job: Job, bench: Benchmark, base: str, variation: Variation) -> Iterator[Wanted]:
    changed, levels = varied(job, base, variation), bench.levels_of(job)
    for seed in bench.seeds:
        label = f"{job.env}, {base}, {variation.label}, seed {seed}"
        name = variation.method(base) or base
        yield Wanted(replace(changed, seed=seed), name, levels, label)


def lines(store: Store, every: Sequence[Case], refs: Sequence[Ref | None]) -> list[ablations.Line]:
    """The table, from evaluations in the order of the cases."""
    found: list[ablations.Line] = []
    left = iter(refs)
    of_base: dict[str, dict[str, list[EpisodeRow]]] = {}
    for case in every:
        of_case = [ref for _, ref in zip(case.evaluations, left, strict=False) if ref]
        first = case.evaluations[0]
        rows = {
            level: [row for ref in of_case for row in wanted.episodes(store, ref, level)]
            for level in first.levels
        }
        before = of_base.setdefault(case.base, rows)
        for level in first.levels:
            against = before[level] if before is not rows else []
            where = first.job.env, level
            paper = case.variation.paper
            label = case.variation.label
            found.append(ablations.line(case.base, label, where, rows[level], against, paper))
    return found
