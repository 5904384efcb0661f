"""The command line: parse, one stage call, print. Only this module prints or exits.

stdout has results: one ref, one table or one JSON document. All talk goes to stderr. Everything
but typer is imported inside the commands, so that `--help` is quick.
"""

from __future__ import annotations

import errno
import json as jsonlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.exceptions import TyperException

from elast_cli.cli.options import (
    ContextInput,
    DatasetInput,
    EncoderInput,
    EnsembleInput,
    Env,
    Evaluating,
    Fitting,
    Json,
    Lineage,
    ModelInputs,
    Running,
    Searching,
    SomeEnv,
    takes,
)
from elast_cli.errors import ElastError, StorageError, UsageError

if TYPE_CHECKING:
    from elast_cli.stages.job import DataJob, Job, Step
    from elast_cli.stages.run import Benchmark
    from elast_cli.store.manifest import Ref
    from elast_cli.store.store import Store

_DISK_ERRORS = {
    errno.EACCES,
    errno.EDQUOT,
    errno.EIO,
    errno.ENOSPC,
    errno.ENOTDIR,
    errno.EPERM,
    errno.EROFS,
}

app = typer.Typer(
    name="elast",
    help="Reach goals given as images: trees planned in a learned latent space.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.command()
@takes(Lineage, Running)
def collect(
    env: Env,
    lineage: Lineage,
    running: Running,
    n: Annotated[
        int | None, typer.Option("--n", min=1, help="Transitions; default: the preset's.")
    ] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes, in place of --n.")] = None,
    max_episode_steps: Annotated[int | None, typer.Option(min=1, help="Steps of each.")] = None,
) -> None:
    """Collect random interaction into a dataset."""
    if n is not None and episodes is not None:
        raise UsageError("--n and --episodes both say how much to collect; give one of them")
    keys = {"episode_steps": max_episode_steps, "n": n}
    extra = [f"collect.{key}={value}" for key, value in keys.items() if value is not None]
    job = _data_job(env, lineage, running, extra)
    if episodes is not None:
        length = job.config.collect.episode_steps
        job = _data_job(env, lineage, running, [*extra, f"collect.n={episodes * length}"])
    from elast_cli.stages import collect as stage

    _finish(stage.step(job), running)


@app.command()
@takes(DatasetInput, Fitting, Lineage, Running)
def train_context(
    env: Env, inputs: DatasetInput, fitting: Fitting, lineage: Lineage, running: Running
) -> None:
    """Train the context autoencoder, where obstacles change with the episode."""
    _train("context", env, inputs, fitting, lineage, running)


@app.command()
@takes(ContextInput, Fitting, Lineage, Running)
def train_encoder(
    env: Env, inputs: ContextInput, fitting: Fitting, lineage: Lineage, running: Running
) -> None:
    """Train the encoder with its forward model (contrastive predictive coding)."""
    _train("encoder", env, inputs, fitting, lineage, running)


@app.command()
@takes(EncoderInput, Fitting, Lineage, Running)
def train_ensemble(
    env: Env, inputs: EncoderInput, fitting: Fitting, lineage: Lineage, running: Running
) -> None:
    """Train the ensemble of latent dynamics."""
    _train("ensemble", env, inputs, fitting, lineage, running)


@app.command()
@takes(EnsembleInput, Fitting, Lineage, Running)
def train_density(
    env: Env, inputs: EnsembleInput, fitting: Fitting, lineage: Lineage, running: Running
) -> None:
    """Train the transition density (noise-contrastive estimation)."""
    _train("density", env, inputs, fitting, lineage, running)


@app.command()
@takes(EnsembleInput, Fitting, Lineage, Running)
def train_policy(
    env: Env, inputs: EnsembleInput, fitting: Fitting, lineage: Lineage, running: Running
) -> None:
    """Train the local policy that leads from one latent to the next."""
    _train("policy", env, inputs, fitting, lineage, running)


@app.command()
@takes(ModelInputs, Searching, Lineage, Running)
def plan(
    env: Env,
    inputs: ModelInputs,
    searching: Searching,
    lineage: Lineage,
    running: Running,
    method: Annotated[str, typer.Option(help="A method that grows a tree.")] = "elast",
    level: Annotated[str | None, typer.Option(help="Default: the hardest.")] = None,
    scenario: Annotated[int, typer.Option(min=0, max=100_000, help="Which one.")] = 0,
    scenario_seed: Annotated[int | None, typer.Option(min=0, help="Seed of scenarios.")] = None,
) -> None:
    """Plan one scenario and explain the plan: JSON edge by edge, and a picture."""
    extra = [] if scenario_seed is None else [f"eval.scenario_seed={scenario_seed}"]
    job = _job(env, lineage, running, [*extra, *searching.overrides()], inputs)
    from elast_cli.envs.registry import spec
    from elast_cli.stages import plan as stage

    step = stage.step(job, method, level or list(spec(env).levels)[-1], scenario)
    _finish(step, running, stage.document)


@app.command("eval")
@takes(Evaluating, ModelInputs, Searching, Lineage, Running)
def evaluate(
    evaluating: Evaluating,
    inputs: ModelInputs,
    searching: Searching,
    lineage: Lineage,
    running: Running,
    env: SomeEnv = None,
) -> None:
    """Evaluate methods: success rates with intervals, pictures, results JSON."""
    from elast_cli.envs.registry import ENVS
    from elast_cli.stages import run as stage
    from elast_cli.store.manifest import Ref

    bench = _bench(evaluating, lineage)
    named = {Ref.parse(text).env for text in asdict(inputs).values() if text}
    extra = [*evaluating.overrides(), *searching.overrides()]
    jobs = [
        _job(name, lineage, running, extra, inputs)
        for name in bench.having_levels([env] if env else named or ENVS)
    ]
    jobs = stage.complete(jobs, bench)
    _report(jobs, bench, running, make=False)


@app.command("run")
@takes(Evaluating, Searching, Lineage, Running)
def run_chain(
    env: Env, evaluating: Evaluating, searching: Searching, lineage: Lineage, running: Running
) -> None:
    """Do everything: data, training, evaluation; what is there already is not done again."""
    bench = _bench(evaluating, lineage)
    bench.having_levels([env])
    job = _job(env, lineage, running, [*evaluating.overrides(), *searching.overrides()])
    _report([job], bench, running, make=True)


@app.command("ls")
def list_artifacts(
    env: SomeEnv = None,
    kind: Annotated[str | None, typer.Option(help="One kind, such as encoder.")] = None,
    json: Json = False,
) -> None:
    """List what there is."""
    from elast_cli.envs.registry import spec
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    if env is not None:
        spec(env)  # an unknown name is an error, not an empty list
    rows = inspect.listing(Store.default(), env, kind)
    _show(rows, inspect.listing_table, json=json)


@app.command()
def show(ref: str, json: Json = False) -> None:
    """Show an artifact: recipe, metrics, files, and its lineage as a tree."""
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    _show(inspect.description(Store.default(), ref), inspect.description_view, json=json)


@app.command()
def verify(
    refs: Annotated[list[str] | None, typer.Argument(metavar="[REF]...")] = None,
    json: Json = False,
) -> None:
    """Check every file and the whole lineage of some artifacts, or of all."""
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    rows = inspect.verified(Store.default(), refs or [])
    _show(rows, inspect.verified_table, json=json)
    inspect.refuse_damaged(rows)


@app.command()
def compare(
    ref_a: Annotated[str, typer.Argument(metavar="REF")],
    ref_b: Annotated[str, typer.Argument(metavar="REF")],
    json: Json = False,
) -> None:
    """Compare two evaluations on the scenarios they share, with intervals."""
    from elast_cli.evaluation.comparison import comparison_table
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    found = inspect.comparison(Store.default(), ref_a, ref_b)
    if json:
        _print_json([row.model_dump(mode="json") for row in found])
    else:
        _print_rich(comparison_table(found))


@app.command()
def gc(json: Json = False) -> None:
    """Remove what interrupted runs left behind, except where one is in progress."""
    from elast_cli.store.store import Store

    removed = [str(path) for path in Store.default().gc()]
    _print_json(removed) if json else _print("\n".join(removed))


@app.command()
def doctor(json: Json = False) -> None:
    """Check this machine: versions, cores, GPU, disk, store, and what mends what is missing."""
    from elast_cli.stages import doctor as stage

    checks = stage.checks()
    _show([check._asdict() for check in checks], stage.table, json=json)
    stage.refuse_failed(checks)


# --- what the commands share -------------------------------------------------------------------


def _job(
    env: str, lineage: Lineage, running: Running, extra: Sequence[str] = (), inputs: Any = None
) -> Job:
    """The job that the flags describe; `extra` are further `--set` texts, which win."""
    options = _options(env, lineage, running)
    given = asdict(inputs) if inputs else {}
    from elast_cli.store.manifest import Ref

    refs = {role: Ref.parse(text) for role, text in given.items() if text is not None}
    from elast_cli import preset
    from elast_cli.stages.job import Job, resolve_device

    config = preset.load(lineage.preset, env, [*(lineage.set or []), *extra])
    device = resolve_device(running.device)
    return Job(**options, config=config, device=device, threads=running.threads, given=refs)


def _data_job(env: str, lineage: Lineage, running: Running, extra: Sequence[str]) -> DataJob:
    """The same for data; without torch, unless more than a shipped preset is to be checked."""
    options = _options(env, lineage, running)
    from elast_cli import layers
    from elast_cli.stages.job import DataJob

    shipped = None if lineage.set else layers.shipped_data(lineage.preset, env, extra)
    if shipped is None or running.device not in ("auto", "cpu"):
        return _job(env, lineage, running, extra)
    return DataJob(**options, config=shipped)


def _options(env: str, lineage: Lineage, running: Running) -> dict[str, Any]:
    """What jobs of all sorts are given."""
    if running.fresh and running.resume:
        raise UsageError("--resume and --fresh contradict each other; give one of them")
    from elast_cli.envs.registry import spec

    spec(env)  # a misspelt name is told at once: the rest takes seconds to import
    from elast_cli.cli import console
    from elast_cli.engine.local import usable_cores
    from elast_cli.store.store import Store

    return {
        "store": Store.default(),
        "env": env,
        "preset": lineage.preset,
        "seed": lineage.seed,
        "workers": running.workers or usable_cores(),
        "progress": console.reporter(quiet=running.quiet),
        "wait": not running.no_wait,
        "force": running.force,
        "fresh": running.fresh,
    }


def _train(
    kind: str, env: str, inputs: Any, fitting: Fitting, lineage: Lineage, running: Running
) -> None:
    from elast_cli.stages import train

    job = _job(env, lineage, running, fitting.overrides(kind), inputs)
    _finish(train.step(job, kind), running)


def _bench(evaluating: Evaluating, lineage: Lineage) -> Benchmark:
    """What is to be evaluated."""
    from elast_cli.stages.run import Benchmark

    return Benchmark.parse(
        evaluating.methods,
        evaluating.level,
        evaluating.seeds,
        lineage.seed,
        evaluating.require or [],
    )


def _report(jobs: Sequence[Job], bench: Benchmark, running: Running, *, make: bool) -> None:
    """Evaluate, print the results of all jobs together, and hold them against the bounds."""
    from elast_cli.stages import run as stage

    bench.expect([job.env for job in jobs])
    if running.dry_run:
        rows = [row for job in jobs for row in stage.planned(job, bench, make=make)]
        _print_json(rows) if running.json else _print(stage.planned_text(rows))
        return
    reports = [stage.evaluate_all(job, bench, make=make) for job in jobs]
    outcome = stage.Outcome.of(jobs[0], reports)
    _print_json(outcome.document(bench)) if running.json else _print(outcome.text())
    outcome.require(bench)


def _finish(
    step: Step, running: Running, document: Callable[[Store, Ref], Any] | None = None
) -> None:
    """Carry out a step, or say what it would do, and print its ref, or its `document` as JSON."""
    from elast_cli.stages import inspect

    if running.dry_run:
        plan = inspect.planned(step)
        _print_json(plan) if running.json else _print(inspect.planned_line(plan))
        return
    ref = step.carry_out()
    if running.json:
        _print_json((document or inspect.made)(step.job.store, ref))
    else:
        _print(str(ref))


def _show(data: Any, view: Any, *, json: bool) -> None:
    """Print JSON data, or what `view` makes of it for people."""
    if json:
        _print_json(data)
    else:
        _print_rich(view(data))


def _print(text: str) -> None:
    """Write to stdout; a reader that has gone away is no error."""
    try:
        sys.stdout.write(text + "\n" if text else "")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_json(data: Any) -> None:
    _print(jsonlib.dumps(data, indent=2, allow_nan=False, ensure_ascii=False))


def _print_rich(shown: Any) -> None:
    """Print a table; its width is the terminal's, or what it needs where there is none."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else 200
    console = Console(width=width, markup=False, highlight=False, emoji=False)
    with console.capture() as capture:
        console.print(shown)
    _print("\n".join(line.rstrip() for line in capture.get().splitlines()))


def _version(wanted: bool) -> None:
    if wanted:
        import elast_cli

        _print(f"elast {elast_cli.__version__}")
        raise typer.Exit


@app.callback()
def _globals(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Reach goals given as images: trees planned in a learned latent space."""
    if context.invoked_subcommand is None:
        _print(context.get_help())


def _terminated(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(143)  # lets every `finally` clean up


def main() -> NoReturn:
    """Run the command line; every expected failure is one line on stderr and an exit code."""
    signal.signal(signal.SIGTERM, _terminated)
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """The exit code of a command line."""
    try:
        code = app(list(arguments), prog_name="elast", standalone_mode=False)
    except ElastError as error:
        return _fail(str(error), error.exit_code)
    except TyperException as error:
        context = getattr(error, "ctx", None)
        hint = f"; see: {context.command_path} --help" if context else ""
        return _fail(error.format_message().rstrip(".") + hint, error.exit_code)
    except OSError as error:
        if error.errno not in _DISK_ERRORS:
            raise
        return _fail(f"I/O error: {error}", StorageError.exit_code)
    if code == 130:  # typer turns Ctrl-C into this
        return _fail("interrupted; the same command continues", code)
    return code if isinstance(code, int) else 0


def _fail(message: str, code: int) -> int:
    """Say why on stderr, on one line."""
    if message:
        sys.stderr.write(f"elast: {' '.join(message.split())}\n")
    return code
