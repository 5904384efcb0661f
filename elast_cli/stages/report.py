"""Results of one or many evaluations as files: JSON, a table, a bar chart, pictures."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from elast_cli.config import JsonDict
from elast_cli.evaluation.rows import EpisodeRow, OverallRow, Results
from elast_cli.evaluation.summary import results_document, summarize
from elast_cli.evaluation.tables import success_notes, table
from elast_cli.stages.job import Job, RecipeJob
from elast_cli.stages.results import RESULTS_FILE, WORLD, read_results, texts
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run

ALGORITHM_VERSION = 1
CHART_FILE = "success.png"
TABLE_FILE = "table.txt"


def write_results(
    folder: Path, rows: Sequence[EpisodeRow], *, lineage: Mapping[str, Any], settings: JsonDict
) -> list[OverallRow]:
    """The overall rows, once the results are in `folder` as JSON."""
    document = results_document(rows, lineage, settings)
    with (folder / RESULTS_FILE).open("x", encoding="utf-8") as file:
        json.dump(document, file, indent=1, allow_nan=False)
    return summarize(rows)


def recipe_job(job: Job, evaluations: Mapping[tuple[str, int], Ref]) -> RecipeJob:
    """The report of one environment over evaluations by (method, training seed).

    Its recipe has the lowest training seed for its own.
    """
    inputs = {f"{method}-seed-{seed}": ref for (method, seed), ref in evaluations.items()}
    seeds = sorted({seed for _, seed in evaluations})
    config: JsonDict = {
        "methods": list(dict.fromkeys(method for method, _ in evaluations)),
        "seeds": list(seeds),
    }
    recipe = replace(job, seed=seeds[0]).recipe(
        "report", config, inputs, algorithm_version=ALGORITHM_VERSION, by_torch=False
    )
    return RecipeJob(job, recipe, inputs, lambda run: _report(job, evaluations, run))


def _report(job: Job, evaluations: Mapping[tuple[str, int], Ref], run: Run) -> JsonDict:
    from elast_cli.pictures.success import bar_chart

    store, staging = job.store, run.staging
    results = {key: read_results(store, ref) for key, ref in evaluations.items()}
    rows = [row for found in results.values() for row in found.per_episode]
    lineage = {str(ref): store.manifest(ref).recipe.parents for ref in evaluations.values()}
    settings = _settings(job, run, list(results.values()))
    overall = write_results(staging, rows, lineage=lineage, settings=settings)
    lines = [table_text(overall), *success_notes([settings])]
    (staging / TABLE_FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")
    bar_chart(overall, staging / CHART_FILE, title=f"{job.env}, preset {job.preset}")
    drawn: set[str] = set()
    for (method, _), ref in evaluations.items():
        for name in store.manifest(ref).files:
            copy = f"{method}-{name}"
            if name.endswith((".png", ".gif")) and copy not in drawn:
                drawn.add(copy)
                shutil.copyfile(store.file(ref, name), staging / copy)
    return {
        f"pc_success_{row.method}_{row.level}": row.pc_success
        for row in overall
        if row.train_seed is None
    }


def _settings(job: Job, run: Run, results: Sequence[Results]) -> JsonDict:
    """The settings that the evaluations share, and the overrides of their models."""
    settings = [found.settings for found in results]
    overrides = [text for found in settings for text in texts(found.get("overrides"))]
    return {
        **run.recipe.config,
        "preset": job.preset,
        **{key: settings[0].get(key) for key in (*WORLD, "episodes", "scenario_seed")},
        "overrides": list(dict.fromkeys(overrides)),
        **{key: settings[0][key] for key in ("success",) if key in settings[0]},
    }


def table_text(overall: Sequence[OverallRow]) -> str:
    """The table as plain text."""
    from io import StringIO

    from rich.console import Console

    out = StringIO()
    Console(file=out, width=200, markup=False, highlight=False).print(table(overall))
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())
