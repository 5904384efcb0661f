"""`elast table`: Table 1 of the paper, from evaluations that are made, or found in the store."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

from elast_cli.errors import DataError, MissingInputError, UsageError, suggestion
from elast_cli.evaluation import paper
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.evaluation.statistics import mean
from elast_cli.evaluation.summary import pooled, summarize
from elast_cli.evaluation.table1 import Costs, Entry
from elast_cli.methods.table import METHODS
from elast_cli.models.parts import PARTS
from elast_cli.stages import wanted
from elast_cli.stages.benchmark import Benchmark, words
from elast_cli.stages.earlier import number
from elast_cli.stages.job import Job
from elast_cli.stages.wanted import Wanted
from elast_cli.store.manifest import Manifest, Ref
from elast_cli.store.store import Store

Cells = Mapping[tuple[str, paper.Column, int], Ref]  # by method, column and training seed


def methods(text: str | None) -> tuple[str, ...]:
    """The rows: the named methods, or those of the paper, the ones that are not there included.

    Raises:
        UsageError: a method that is neither in elast nor in the paper.
    """
    if text is None:
        return paper.METHODS
    found = words(text, "--methods")
    known = list(dict.fromkeys([*METHODS, *paper.METHODS]))
    for name in found:
        if name not in known:
            raise UsageError(
                f"unknown method {name!r}{suggestion(name, known)}; choose {', '.join(known)}"
            )
    return found


def environments(text: str | None) -> tuple[str, ...]:
    """The environments of the columns: the named ones, or all of the paper.

    Raises:
        UsageError: an environment that is no column.
    """
    every = tuple(dict.fromkeys(column.env for column in paper.COLUMNS))
    found = every if text is None else words(text, "--envs")
    for name in found:
        if name not in every:
            hint = suggestion(name, every)
            raise UsageError(f"no column for {name!r}{hint}; choose {', '.join(every)}")
    return found


def evaluations(jobs: Sequence[Job], names: Sequence[str], seeds: Sequence[int]) -> list[Wanted]:
    """What the table wants: all levels of each environment, as `elast run` evaluates them.

    Methods that are not there are left out; their cells stay empty.

    Args:
        jobs: one an environment.
        names: of methods.
        seeds: of training.
    """
    return [
        Wanted(
            replace(job, seed=seed),
            name,
            tuple(job.task_info.levels),
            f"{job.env}, {name}, seed {seed}",
        )
        for job in jobs
        for seed in seeds
        for name in names
        if name in METHODS
    ]


def sections(names: Sequence[str]) -> set[str]:
    """The sections of a preset that the methods use, training included."""
    return Benchmark(tuple(name for name in names if name in METHODS), None, ()).sections(make=True)


def made(every: Sequence[Wanted], refs: Sequence[Ref | None]) -> Cells:
    """Cells of evaluations that were made."""
    return {
        (one.method, column, one.job.seed): ref
        for one, ref in zip(every, refs, strict=True)
        if ref
        for column in _columns(one.job.env)
    }


def stored(every: Sequence[Wanted]) -> Cells:
    """Cells of evaluations that are in the store; nothing is made."""
    return {
        (one.method, column, one.job.seed): ref
        for one in every
        for column in _columns(one.job.env)
        if (ref := wanted.stored(one, column.level))
    }


def _columns(env: str) -> list[paper.Column]:
    return [column for column in paper.COLUMNS if column.env == env]


def entries(store: Store, cells: Cells, envs: Sequence[str], names: Sequence[str]) -> list[Entry]:
    """The table, method by method; cells without an evaluation are empty."""
    return [
        _entry(
            store, name, column, [ref for key, ref in cells.items() if key[:2] == (name, column)]
        )
        for name in names
        for column in paper.COLUMNS
        if column.env in envs
    ]


def _entry(store: Store, name: str, column: paper.Column, refs: Sequence[Ref]) -> Entry:
    known = paper.paper_rate(name, column.env, column.level)
    if not refs:
        return Entry(name, column, known)
    rows = [row for ref in refs for row in wanted.episodes(store, ref, column.level)]
    manifests = [store.manifest(ref) for ref in refs]
    return Entry(
        name,
        column,
        known,
        overall=pooled(summarize(rows))[0],
        costs=_costs(store, rows, manifests),
        commits=tuple(dict.fromkeys(map(_commit, manifests))),
        refs=tuple(map(str, refs)),
    )


def _commit(manifest: Manifest) -> str:
    """The commit that made an artifact; a plus marks changes that were not committed."""
    commit = manifest.provenance.get("git_commit")
    dirty = "+" if manifest.provenance.get("git_dirty") else ""
    return f"{str(commit)[:7]}{dirty}" if commit else f"elast {manifest.provenance.get('elast')}"


def _costs(store: Store, rows: Sequence[EpisodeRow], manifests: Sequence[Manifest]) -> Costs:
    """CPU time of the episodes, and what the parts took that they were run with."""
    parts = [_parts(store, manifest) for manifest in manifests]
    memory = [number(part.metrics, "peak_memory_gb") for of in parts for part in of]
    minutes = mean([sum(map(_seconds, of)) / 60 for of in parts])
    return Costs(
        cpu_s_per_step=mean([row.cpu_s_per_step for row in rows if row.cpu_s_per_step is not None]),
        training_minutes=None if minutes is None or math.isnan(minutes) else minutes,
        peak_memory_gb=max((x for x in memory if not math.isnan(x)), default=None),
        parameters=sum(_parameters(store, part.ref) for part in parts[0]),
    )


def _seconds(part: Manifest) -> float:
    """CPU seconds of a training, or by the clock where those are unknown."""
    cpu = number(part.metrics, "cpu_s")
    return number(part.metrics, "wall_s") if math.isnan(cpu) else cpu


def _parts(store: Store, manifest: Manifest) -> list[Manifest]:
    """The learned parts that an evaluation was run with; those that are lost are left out."""
    found = []
    for role, parent in manifest.parents.items():
        try:
            if role in PARTS:
                found.append(store.manifest(Ref.parse(parent.ref)))
        except (DataError, MissingInputError):
            continue
    return found


@cache
def _parameters(store: Store, ref: Ref) -> int:
    """Trained numbers of a part."""
    from elast_cli.models.files import parameter_count

    return parameter_count(store.path(ref), ref.kind)
