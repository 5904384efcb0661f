"""From flags to jobs, and jobs carried out. Imports are inside, so that `--help` is quick."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from json import dumps
from typing import TYPE_CHECKING, Any

from elast_cli.cli.options import Evaluating, Lineage, Override, Running
from elast_cli.cli.output import print_json, print_rich, print_text
from elast_cli.errors import UsageError

if TYPE_CHECKING:
    from elast_cli.preset import Preset
    from elast_cli.progress import Progress
    from elast_cli.stages.benchmark import Benchmark
    from elast_cli.stages.job import Job, RecipeJob
    from elast_cli.store.manifest import Ref
    from elast_cli.store.store import Store


def job_of(
    env: str,
    lineage: Lineage,
    running: Running,
    extra: Sequence[Override] = (),
    given: Mapping[str, str | None] | None = None,
) -> Job:
    """The job that the flags describe.

    Args:
        env: the environment's name, or the id of an outside one.
        lineage: preset, overrides, seed.
        running: how to run.
        extra: what other flags override; they win.
        given: refs named on the command line, by kind.
    """
    from elast_cli.stages.job import Job, resolve_device
    from elast_cli.stages.trust import identified

    _refuse_contradiction(running)
    store = _store()
    name, env_id = identified(store, env, trusted=lineage.trust_code)
    return Job(
        store=store,
        env=name,
        preset=lineage.preset,
        config=_config(name, lineage, [*_naming(env_id), *extra]),
        seed=lineage.seed,
        device=resolve_device(running.device),
        threads=running.threads,
        workers=running.workers or _cores(),
        memory_gb=running.memory,
        progress=_reporter(quiet=running.quiet),
        given=_refs(given or {}),
        wait=not running.no_wait,
        force=running.force,
        fresh=running.fresh,
    )


def _reporter(*, quiet: bool) -> Progress:
    from elast_cli.cli import console

    return console.reporter(quiet=quiet)


def _store() -> Store:
    from elast_cli.store.store import Store

    return Store.default()


def _config(env: str, lineage: Lineage, extra: Sequence[Override]) -> Preset:
    from elast_cli.stages import presets

    flags = [*lineage.overrides(), *extra]
    return presets.load(lineage.preset, env, lineage.set or [], flags, trusted=lineage.trust_code)


def _naming(env_id: str | None) -> list[Override]:
    """The override that says which outside environment is meant."""
    return [] if env_id is None else [Override("--env", f"env.id={dumps(env_id)}")]


def _cores() -> int:
    from elast_cli.engine.local import usable_cores

    return usable_cores()


def _refs(given: Mapping[str, str | None]) -> dict[str, Ref]:
    """The refs that texts name, where there are any."""
    from elast_cli.store.manifest import Ref

    return {role: Ref.parse(text) for role, text in given.items() if text is not None}


def _refuse_contradiction(running: Running) -> None:
    """Raise UsageError if flags ask for opposite things."""
    if running.fresh and running.resume:
        raise UsageError("--resume and --fresh contradict each other; give one of them")


def unused(lineage: Lineage, extra: Sequence[Override], uses: Collection[str]) -> list[str]:
    """A note on each override of a section that a command does not use.

    Commands print the notes once nothing is left to refuse: a refusal is one line.

    Args:
        lineage: with the texts of `--set`.
        extra: what other flags override.
        uses: sections of the preset that have an effect.
    """
    by_set = [("--set", text) for text in lineage.set or []]
    given = [*by_set, *lineage.overrides(), *extra]
    found = [(flag, text.partition(".")[0].strip(), text) for flag, text in given]
    return [
        f"{flag}: section {section!r} has no effect here ({text})"
        for flag, section, text in found
        if section not in uses
    ]


def benchmark_of(evaluating: Evaluating, lineage: Lineage) -> Benchmark:
    """What is to be evaluated."""
    from elast_cli.stages.benchmark import Benchmark

    return Benchmark.parse(
        evaluating.methods,
        evaluating.level,
        evaluating.seeds,
        lineage.seed,
        evaluating.require or [],
        allow_overrides=evaluating.allow_overrides,
    )


def report(
    jobs: Sequence[Job],
    bench: Benchmark,
    running: Running,
    notes: Sequence[str] = (),
    *,
    make: bool,
) -> None:
    """Evaluate, print the results of all jobs together, and hold them against the bounds."""
    from elast_cli.cli.dry_run import show_chain
    from elast_cli.stages import run

    bench.expect(jobs)
    note(jobs[0], notes)
    if running.dry_run:
        rows = [row for job in jobs for row in run.planned(job, bench, make=make)]
        show_chain(rows, json=running.json)
        return
    reports = [run.evaluate_all(job, bench, make=make) for job in jobs]
    outcome = run.Outcome.of(jobs[0], reports)
    print_json(outcome.document(bench)) if running.json else print_rich(outcome.view())
    outcome.require(bench)


def note(job: Job, notes: Sequence[str]) -> None:
    """Print notes on stderr, unless the command is quiet."""
    for text in notes:
        job.progress.note(text)


def finish(
    wanted: RecipeJob,
    running: Running,
    notes: Sequence[str] = (),
    document: Callable[[Store, Ref], Any] | None = None,
    remark: Callable[[Store, Ref], str] | None = None,
    text: Callable[[Store, Ref], str] | None = None,
) -> None:
    """Carry out a recipe job, or say what that would do, and print what was made.

    Args:
        wanted: the recipe job.
        running: how to run.
        notes: on stderr, once nothing is left to refuse.
        document: what `--json` prints; by default what every stage prints.
        remark: a note on what was made.
        text: what is printed else; by default the ref.
    """
    from elast_cli.cli.dry_run import show_stage
    from elast_cli.stages import estimate, inspect

    note(wanted.job, notes)
    if running.dry_run:
        show_stage(inspect.planned(wanted) | estimate.of(wanted).document(), json=running.json)
        return
    ref = wanted.carry_out()
    if remark:
        note(wanted.job, [remark(wanted.job.store, ref)])
    if running.json:
        print_json((document or inspect.made)(wanted.job.store, ref))
    else:
        print_text(text(wanted.job.store, ref) if text else str(ref))
