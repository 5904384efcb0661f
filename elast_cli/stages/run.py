"""`elast eval` and `elast run`: methods by training seeds into one report an environment."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING

from elast_cli.config import JsonDict
from elast_cli.errors import MissingInputError, RequirementError
from elast_cli.evaluation.requirements import check
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.evaluation.summary import results_document, summarize
from elast_cli.evaluation.tables import success_notes, table
from elast_cli.methods.table import method_named
from elast_cli.progress import Silent
from elast_cli.stages import estimate, evaluate, report
from elast_cli.stages.benchmark import Benchmark
from elast_cli.stages.chain import make_models, planned_models, planned_row
from elast_cli.stages.job import Job
from elast_cli.stages.resolve import present, resolve, roles_of
from elast_cli.stages.results import read_results, texts
from elast_cli.store.manifest import Ref

if TYPE_CHECKING:
    from rich.console import Group


def complete(jobs: Sequence[Job], bench: Benchmark) -> list[Job]:
    """The jobs whose models all exist; for the others, note the command that makes them.

    Raises:
        MissingInputError: there is no such job.
    """
    found, missing = [], []
    for job in jobs:
        try:
            for seed, name in product(bench.seeds, bench.methods):
                method = method_named(name)
                of_seed = replace(job, seed=seed, progress=Silent())
                resolve(of_seed.of_method(method), method.parts)
            found.append(job)
        except MissingInputError as error:
            missing.append(error)
    if not found:
        raise missing[0]
    for reason in missing:
        found[0].progress.note(f"left out: {reason}")
    return found


def evaluate_all(job: Job, bench: Benchmark, *, make: bool) -> Ref:
    """The report of one environment; with `make`, missing data and models are made first."""
    levels = bench.levels_of(job)
    evaluations: dict[tuple[str, int], Ref] = {}
    for seed in bench.seeds:
        of_seed = replace(job, seed=seed)
        parts = make_parts(of_seed, bench.methods) if make else {}
        for name in bench.methods:
            given = replace(of_seed, given=parts.get(name, of_seed.given))
            evaluations[name, seed] = evaluate.recipe_job(given, name, levels).carry_out()
    return report.recipe_job(job, evaluations).carry_out()


Made = dict[tuple[str, str], Ref]  # parts by role and by what is changed in them


def make_parts(
    job: Job, methods: Sequence[str], made: Made | None = None
) -> dict[str, dict[str, Ref]]:
    """The parts of each method by its name, made where they are missing.

    A part is made once for all methods that share it; one that a method changes is its own.

    Args:
        job: environment, preset, seed, and how to run.
        methods: names.
        made: parts of this environment and seed that were made before; gets those of these.
    """
    made = {} if made is None else made
    parts: dict[str, dict[str, Ref]] = {}
    for name in methods:
        method = method_named(name)
        of_method = job.of_method(method)
        keys = {role: _key(of_method, role) for role in roles_of(job, method.parts)}
        known = {role: made[key] for role, key in keys.items() if key in made}
        parts[name] = make_models(of_method, method.parts, known)
        made |= {keys[role]: ref for role, ref in parts[name].items()}
    return parts


def _key(job: Job, role: str) -> tuple[str, str]:
    """The key of a role's artifact: methods with equal keys share it."""
    return role, json.dumps(job.variant(role), sort_keys=True)


def planned(job: Job, bench: Benchmark, *, make: bool) -> list[JsonDict]:
    """What `evaluate_all` would find and make, in order."""
    rows: list[JsonDict] = []
    evaluations: dict[tuple[str, int], Ref] = {}
    levels = bench.levels_of(job)
    for seed in bench.seeds:
        of_seed = replace(job, seed=seed)
        listed: set[tuple[str, str]] = set()
        for name in bench.methods:
            found, ref = planned_method(of_seed, name, levels, listed, make=make)
            rows += found
            if ref:
                evaluations[name, seed] = ref
    every = len(evaluations) == len(bench.methods) * len(bench.seeds)
    there = report.recipe_job(job, evaluations).published() if every else None
    counts = {"methods": len(bench.methods), "seeds": len(bench.seeds), "levels": len(levels)}
    cost = estimate.NOTHING if there else estimate.of_report(job, **counts)
    rows.append(planned_row(replace(job, seed=min(bench.seeds)), "report", there, cost))
    return rows


def planned_method(
    job: Job, name: str, levels: Sequence[str], listed: set[tuple[str, str]], *, make: bool
) -> tuple[list[JsonDict], Ref | None]:
    """What the evaluation of a method would find and make, and the evaluation that is there.

    Args:
        job: environment, preset and seed.
        name: of the method.
        levels: to evaluate.
        listed: parts that are listed already; gets those of this method.
        make: with all parts that are missing.
    """
    method, rows = method_named(name), []
    given = job.of_method(method)
    if make:
        models = planned_models(given, method.parts)
        rows += [row for row in models if _key(given, str(row["kind"])) not in listed]
        listed |= {_key(given, str(row["kind"])) for row in models}
        refs = {str(row["kind"]): Ref.maybe(str(row["published"])) for row in models}
        given = replace(given, given={kind: ref for kind, ref in refs.items() if ref})
    ref, needed = None, present(job, method.parts)
    if not make or all(role in given.given for role in needed):
        ref = evaluate.recipe_job(given, name, levels).published()
    config = evaluate.recipe_config(given, name, levels)
    cost = estimate.NOTHING if ref else estimate.of_evaluation(given, config)
    return [*rows, planned_row(job, f"eval {name}", ref, cost)], ref


@dataclass(frozen=True)
class Outcome:
    """Reports of some environments, read together."""

    rows: list[EpisodeRow]
    lineage: JsonDict
    folders: dict[str, str]
    overrides: list[str]
    success: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, job: Job, reports: Sequence[Ref]) -> Outcome:
        """The episodes of all reports."""
        store = job.store
        results = [read_results(store, ref) for ref in reports]
        lineage: JsonDict = {
            str(ref): {role: parent.ref for role, parent in store.manifest(ref).parents.items()}
            for ref in reports
        }
        return cls(
            [row for found in results for row in found.per_episode],
            lineage,
            {str(ref): str(store.path(ref)) for ref in reports},
            [text for found in results for text in texts(found.settings.get("overrides"))],
            success_notes(found.settings for found in results),
        )

    def document(self, bench: Benchmark) -> JsonDict:
        """The results JSON."""
        settings = {
            "methods": bench.methods,
            "seeds": bench.seeds,
            "reports": self.folders,
            "overrides": self.overrides,
            "success": self.success,
        }
        return results_document(self.rows, self.lineage, settings)

    def view(self) -> Group:
        """The table, what decides success, what was overridden, and where the pictures are."""
        from rich.console import Group
        from rich.text import Text

        notes = [*self.success, *(f"not of the preset: {text}" for text in self.overrides)]
        notes += [f"{ref}: table, results and pictures in {at}" for ref, at in self.folders.items()]
        return Group(table(summarize(self.rows)), Text("\n".join(notes)))

    def require(self, bench: Benchmark) -> None:
        """Raise RequirementError if a bound is missed."""
        if not bench.requirements:
            return
        if self.overrides and not bench.allow_overrides:
            raise RequirementError(
                f"models are not of the preset: {'; '.join(self.overrides)}; "
                "train them again, or add --allow-overrides"
            )
        verdicts = check(bench.requirements, summarize(self.rows))
        missed = [f"{v.text} has {v.value:.1f}" for v in verdicts if not v.ok]
        if missed:
            raise RequirementError(f"missed: {'; '.join(missed)}")
