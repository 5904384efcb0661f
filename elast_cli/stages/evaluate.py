"""`elast eval`: episodes of one method as one artifact, resumable episode by episode."""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.envs.registry import make, scenarios
from elast_cli.envs.scenario import Scenario
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.methods.table import method_named
from elast_cli.progress import Within
from elast_cli.seeding import derived_seed
from elast_cli.stages.done_episodes import read_frames, read_row, write_frames, write_row
from elast_cli.stages.job import (
    Job,
    RecipeJob,
    note_if_unrepeatable,
    time_budget,
    verify_files,
)
from elast_cli.stages.presets import EvalConfig
from elast_cli.stages.report import write_results
from elast_cli.stages.resolve import overrides, resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run

if TYPE_CHECKING:
    from elast_cli.control.episodes import Trace

ALGORITHM_VERSION = 12


def recipe_job(job: Job, method: str, levels: Sequence[str]) -> RecipeJob:
    """The evaluation of one method on some levels.

    Raises:
        UsageError: unknown method or level.
        MissingInputError: a model that the method needs is not made yet.
    """
    entry = method_named(method)
    inputs = resolve(job.of_method(entry), entry.parts)
    config = recipe_config(job, method, levels)
    recipe = job.recipe("eval", config, inputs, algorithm_version=ALGORITHM_VERSION)
    return RecipeJob(job, recipe, inputs, lambda run: _evaluate(job, method, levels, inputs, run))


def recipe_config(job: Job, method: str, levels: Sequence[str]) -> JsonDict:
    """The configuration of an evaluation; inputs are no part of it."""
    settings = job.config.section("eval", EvalConfig)
    return {
        "method": method,
        "sections": method_named(method).settings(job.config),
        "env": job.config.env,
        "levels": {level: job.task_info.level(level).max_steps for level in levels},
        "episodes": settings.episodes,
        "scenario_seed": settings.scenario_seed,
        "domain": settings.domain,
    }


@dataclass(frozen=True)
class _Chunk:
    """A few episodes of one level for one worker."""

    job: Job
    method: str
    inputs: Mapping[str, Ref]
    scenarios: tuple[Scenario, ...]
    folder: Path


def _evaluate(
    job: Job, method: str, levels: Sequence[str], inputs: Mapping[str, Ref], run: Run
) -> JsonDict:
    began = time.monotonic()
    note_if_unrepeatable(job, method_named(method))
    verify_files(job.store, inputs)  # once, before any worker reads them
    every = [scenario for level in levels for scenario in _scenarios(job, level)]
    _run_missing(job, method, inputs, every, run.work)
    rows = [row for s in every if (row := read_row(run.work, s.level, s.index))]
    assert len(rows) == len(every)
    for level in levels:
        _draw(run, method, level, [row for row in rows if row.level == level])
    lineage = {role: str(ref) for role, ref in inputs.items()}
    found = overrides(job.of_method(method_named(method)), inputs.values())
    settings: JsonDict = {**run.recipe.config, "overrides": list(found)}
    if success := job.task_info.success:
        settings["success"] = success
    overall = write_results(run.staging, rows, lineage=lineage, settings=settings)
    metrics: JsonDict = {f"pc_success_{r.level}": r.pc_success for r in overall}
    metrics["repeatable"] = time_budget(job, method_named(method)) is None
    return {**metrics, "episodes": len(rows), "wall_s": round(time.monotonic() - began, 3)}


def _run_missing(
    job: Job, method: str, inputs: Mapping[str, Ref], every: Sequence[Scenario], folder: Path
) -> None:
    """Run those episodes whose row is not in `folder`; progress counts steps of their budgets."""
    missing = [s for s in every if read_row(folder, s.level, s.index) is None]
    total, left = (sum(_budget(job, s) for s in some) for some in (every, missing))
    chunks = _chunks(job, method, inputs, missing, folder)
    with (
        job.progress.task(f"{method} (steps)", total, total - left) as advance,
        job.engine.relayed(Within(job.progress, advance), len(chunks)) as progress,
    ):
        sent = [replace(chunk, job=replace(job, progress=progress)) for chunk in chunks]
        for _ in job.engine.each(_run_chunk, sent):
            pass


def _budget(job: Job, scenario: Scenario) -> int:
    """Most steps of an episode."""
    return job.task_info.level(scenario.level).max_steps


def _scenarios(job: Job, level: str) -> list[Scenario]:
    settings = job.config.section("eval", EvalConfig)
    return scenarios(
        job.env,
        level,
        seed=settings.scenario_seed,
        count=settings.episodes,
        domain=settings.domain,
        config=job.config.env,
    )


def _chunks(
    job: Job, method: str, inputs: Mapping[str, Ref], missing: Sequence[Scenario], folder: Path
) -> list[_Chunk]:
    """Episodes of one level each, as many as run side by side, equally many for every worker."""
    found = []
    beside = job.config.section("eval", EvalConfig).num_envs
    for level in dict.fromkeys(scenario.level for scenario in missing):
        of_level = [scenario for scenario in missing if scenario.level == level]
        rounds = -(-len(of_level) // (beside * job.workers))
        size = -(-len(of_level) // (rounds * job.workers))
        found += [
            _Chunk(job, method, inputs, tuple(of_level[first : first + size]), folder)
            for first in range(0, len(of_level), size)
        ]
    return found


def _run_chunk(chunk: _Chunk) -> None:
    """Run and write a few episodes; an episode does not depend on those beside it."""
    from elast_cli.compiled import Compiling
    from elast_cli.control.episodes import run_episodes
    from elast_cli.methods.loading import controller

    job = chunk.job
    max_steps = _budget(job, chunk.scenarios[0])
    envs = [make(job.env, job.config.env) for _ in chunk.scenarios]
    folders = {role: job.store.path(ref) for role, ref in chunk.inputs.items()}
    rows, cpu = len(envs), time.process_time()
    with (
        job.progress.task(chunk.method, rows * max_steps) as advance,
        Compiling(job.progress.note),
        ExitStack() as stack,
    ):
        for env in envs:
            stack.callback(env.close)
        traces = run_episodes(
            controller(
                chunk.method,
                folders,
                job.config,
                job.env,
                device=job.device,
                rows=rows,
                threads=job.threads,
            ),
            envs,
            chunk.scenarios,
            max_steps=max_steps,
            seeds=np.array([plan_seed(job, scenario) for scenario in chunk.scenarios]),
            keep_frames=True,
            advance=advance,
        )
    cpu = time.process_time() - cpu
    _keep(chunk, traces, cpu / max(1, sum(trace.length for trace in traces)))


def _keep(chunk: _Chunk, traces: Sequence[Trace], cpu_s_per_step: float) -> None:
    """Put episodes on disk, with the frames of those that may be drawn."""
    kept: set[bool] = set()  # the first success and the first failure are drawn
    for scenario, trace in zip(chunk.scenarios, traces, strict=True):
        success = trace.steps is not None
        if success not in kept:
            kept.add(success)
            assert trace.frames is not None
            where = chunk.folder, scenario.level, scenario.index
            write_frames(*where, trace.frames, trace.goal)
        row = _row(chunk.job, chunk.method, scenario, trace)
        write_row(chunk.folder, row.model_copy(update={"cpu_s_per_step": cpu_s_per_step}))


def plan_seed(job: Job, scenario: Scenario) -> int:
    """Seed of all planning in an episode."""
    level = zlib.crc32(scenario.level.encode())
    return derived_seed("plan", job.seed, scenario.seed, level, scenario.index)


def _row(job: Job, method: str, scenario: Scenario, trace: Trace) -> EpisodeRow:
    log, b, length = trace.log, trace.row, max(trace.length, 1)
    plans = int(log.plans[b])
    return EpisodeRow(
        env=job.env,
        level=scenario.level,
        method=method,
        train_seed=job.seed,
        episode_ix=scenario.index,
        seed=scenario.seed,
        success=trace.steps is not None,
        steps=trace.steps,
        shortest=scenario.shortest,
        plans=plans,
        plan_s=float(log.seconds[b]) / max(plans, 1),
        first_plan_s=float(log.first_seconds[b]),
        reached=int(log.reached[b]),
        network_calls_per_step=int(log.cost.transitions[b]) / length,
        density_calls_per_step=int(log.cost.density_calls[b]) / length,
        policy_calls_per_step=int(log.cost.policy_calls[b]) / length,
        held=trace.held,
    )


def _draw(run: Run, method: str, level: str, rows: Iterable[EpisodeRow]) -> None:
    """A film strip and an animation of the first success and of the first failure."""
    from elast_cli.pictures.film import animation, film_strip

    left = {True: "success", False: "failure"}
    for row in rows:
        shown = read_frames(run.work, level, row.episode_ix) if row.success in left else None
        if shown is None:
            continue
        frames, goal = shown
        name = left.pop(row.success)
        caption = f"{method}, {row.env} {level} {row.episode_ix}: {name}"
        pictures: Any = run.staging / f"{level}-{name}"
        film_strip(frames, goal, pictures.with_suffix(".png"), caption=caption)
        animation(
            frames, goal, pictures.with_suffix(".gif"), caption=caption, success_step=row.steps
        )
