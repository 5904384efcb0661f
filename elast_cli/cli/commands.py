"""The commands: parse, one call, print. Everything but typer is imported inside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from elast_cli.cli import completion
from elast_cli.cli.figure import figure
from elast_cli.cli.jobs import benchmark_of, finish, job_of, note, report, unused
from elast_cli.cli.options import (
    Env,
    Evaluating,
    Fitting,
    Json,
    Lineage,
    NoFitting,
    Running,
    Searching,
    SomeEnv,
    given,
    inputs_of,
    takes,
)
from elast_cli.cli.output import print_json, print_rich, print_text, show_data
from elast_cli.cli.planning import plan
from elast_cli.cli.sharing import bundle, unbundle
from elast_cli.cli.tables import ablate, table
from elast_cli.errors import UsageError
from elast_cli.models.parts import DATASET, PARTS, Part, closure, word

AllInputs: Any = inputs_of([DATASET, *PARTS])


def register(app: typer.Typer) -> None:
    """Add all commands, in the order in which `--help` lists them."""
    app.command()(collect)
    for part in PARTS.values():
        app.command(f"train-{word(part.kind)}", help=part.about)(_train_command(part))
    app.command()(train_baseline)
    app.command()(plan)
    app.command()(figure)
    app.command("eval")(evaluate)
    app.command("run")(run_chain)
    app.command()(table)
    app.command()(ablate)
    app.command("ls")(list_artifacts)
    app.command("report")(write_report)
    for command in (show, verify, compare, bundle, unbundle, envs, methods, gc, doctor):
        app.command()(command)


@takes(Lineage, Running)
def collect(
    env: Env,
    lineage: Lineage,
    running: Running,
    n: Annotated[
        int | None, typer.Option("--n", min=1, help="Transitions; default: from the preset.")
    ] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes, instead of --n.")] = None,
    max_episode_steps: Annotated[
        int | None, typer.Option(min=1, help="Steps of an episode.")
    ] = None,
) -> None:
    """Collect random interaction into a dataset."""
    if n is not None and episodes is not None:
        raise UsageError("--n and --episodes both say how much to collect; give one of them")
    extra = given(
        ("--max-episode-steps", "collect.episode_steps", max_episode_steps), ("--n", "collect.n", n)
    )
    job = job_of(env, lineage, running, extra)
    if episodes is not None:
        length = int(str(job.config.plain("collect")["episode_steps"]))
        extra += given(("--episodes", "collect.n", episodes * length))
        job = job_of(env, lineage, running, extra)
    from elast_cli.stages import collect as stage

    finish(stage.recipe_job(job), running, unused(lineage, extra, ("env", "collect")))


def _train_command(part: Part) -> Callable[..., None]:
    """The command that trains a part; it takes refs of all that the part is made from."""
    inputs_class: Any = inputs_of(closure([part.kind])[:-1])
    fitting_class: Any = Fitting if part.fitted else NoFitting

    def train(env: Env, inputs: Any, fitting: Any, lineage: Lineage, running: Running) -> None:
        from elast_cli.stages import train as stage

        extra = fitting.overrides(part.kind)
        job = job_of(env, lineage, running, extra, asdict(inputs))
        wanted = stage.recipe_job(job, part.kind)
        finish(wanted, running, unused(lineage, extra, ("env", part.kind)))

    train.__annotations__ |= {"inputs": inputs_class, "fitting": fitting_class}
    return takes(inputs_class, fitting_class, Lineage, Running)(train)


@takes(Lineage, Running)
def train_baseline(
    method: Annotated[str, typer.Argument(metavar="METHOD", autocompletion=completion.methods)],
    env: Env,
    lineage: Lineage,
    running: Running,
) -> None:
    """Make the data and all learned parts that a method needs; print one ref per line."""
    from elast_cli.cli.dry_run import show_chain
    from elast_cli.methods.table import method_named
    from elast_cli.stages import chain

    wanted = method_named(method)
    job = job_of(env, lineage, running).of_method(wanted)
    note(job, unused(lineage, [], ("env", "collect", *closure(wanted.parts))))
    if running.dry_run:
        rows = chain.planned_models(job, wanted.parts)
        show_chain(rows, json=running.json)
        return
    made = {role: str(ref) for role, ref in chain.make_models(job, wanted.parts).items()}
    print_json(made) if running.json else print_text("\n".join(made.values()))


@takes(Evaluating, AllInputs, Searching, Lineage, Running)
def evaluate(
    evaluating: Evaluating,
    inputs: AllInputs,
    searching: Searching,
    lineage: Lineage,
    running: Running,
    env: SomeEnv = None,
) -> None:
    """Evaluate methods: success rates with intervals, pictures, results JSON."""
    from elast_cli.envs.registry import names
    from elast_cli.stages import run as stage
    from elast_cli.store.manifest import Ref

    bench = benchmark_of(evaluating, lineage)
    named = {Ref.parse(text).env for text in asdict(inputs).values() if text}
    extra = [*evaluating.overrides(), *searching.overrides()]
    jobs = [
        job_of(name, lineage, running, extra, asdict(inputs))
        for name in ([env] if env else named or names())
    ]
    jobs = stage.complete(bench.having_levels(jobs), bench)
    notes = unused(lineage, extra, bench.sections(make=False))
    report(jobs, bench, running, notes, make=False)


@takes(Evaluating, Searching, Lineage, Running)
def run_chain(
    env: Env, evaluating: Evaluating, searching: Searching, lineage: Lineage, running: Running
) -> None:
    """Run the whole chain: data, training, evaluation. Finished artifacts are reused."""
    bench = benchmark_of(evaluating, lineage)
    extra = [*evaluating.overrides(), *searching.overrides()]
    job = job_of(env, lineage, running, extra)
    notes = unused(lineage, extra, bench.sections(make=True))
    report(bench.having_levels([job]), bench, running, notes, make=True)


def list_artifacts(
    env: SomeEnv = None,
    kind: Annotated[str | None, typer.Option(help="One kind, such as encoder.")] = None,
    json: Json = False,
) -> None:
    """List artifacts."""
    from elast_cli.envs.registry import named
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    if env is not None:
        env, _ = named(env)  # an unknown name is an error, not an empty list
    rows = inspect.listing(Store.default(), env, kind)
    show_data(rows, inspect.listing_table, json=json)


def show(ref: str, json: Json = False) -> None:
    """Show an artifact: recipe, metrics, files, and its lineage as a tree."""
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    show_data(inspect.description(Store.default(), ref), inspect.description_view, json=json)


def verify(
    refs: Annotated[list[str] | None, typer.Argument(metavar="[REF]...")] = None,
    json: Json = False,
) -> None:
    """Check all files and the lineage of some artifacts, or of all."""
    from elast_cli.stages import inspect
    from elast_cli.store.store import Store

    rows = inspect.verified(Store.default(), refs or [])
    show_data(rows, inspect.verified_table, json=json)
    inspect.refuse_damaged(rows)


def compare(
    ref_a: Annotated[str, typer.Argument(metavar="REF")],
    ref_b: Annotated[str, typer.Argument(metavar="REF")],
    json: Json = False,
) -> None:
    """Compare two evaluations on the scenarios they share, with intervals."""
    from elast_cli.evaluation.comparison import comparison_table
    from elast_cli.stages import results
    from elast_cli.store.store import Store

    store = Store.default()
    found = results.comparison(store, ref_a, ref_b)
    if json:
        print_json([row.model_dump(mode="json") for row in found])
        return
    print_rich(comparison_table(found))
    if notes := results.success_of(store, ref_a, ref_b):
        print_text("\n".join(notes))


def write_report(
    refs: Annotated[list[str] | None, typer.Argument(metavar="[REF]...")] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The page.", dir_okay=False)
    ] = Path("report.html"),
    json: Json = False,
) -> None:
    """Write evaluations as one HTML page: tables, charts, films, commands, lineage."""
    from elast_cli.files import storage_errors, whole_file
    from elast_cli.pictures.page import page
    from elast_cli.stages.page import document
    from elast_cli.store.store import Store

    content = document(Store.default(), refs or [])
    with storage_errors(), whole_file(output) as file:
        file.write(page(content).encode())
    shown = {"path": str(output), "evaluations": content["evaluations"]}
    print_json(shown) if json else print_text(str(output))


def envs(json: Json = False) -> None:
    """List the environments for --env."""
    from elast_cli.stages import catalog

    show_data(catalog.environments(), catalog.environments_table, json=json)


def methods(json: Json = False) -> None:
    """List the methods for --methods, and the learned parts that each needs."""
    from elast_cli.stages import catalog

    show_data(catalog.methods(), catalog.methods_table, json=json)


def gc(json: Json = False) -> None:
    """Remove the state of interrupted runs. Runs in progress keep theirs."""
    from elast_cli.store.store import Store

    removed = [str(path) for path in Store.default().gc()]
    print_json(removed) if json else print_text("\n".join(removed))


def doctor(json: Json = False) -> None:
    """Check versions, cores, GPU, disk and store, and suggest fixes."""
    from elast_cli.stages import doctor as stage

    checks = stage.checks()
    show_data([check._asdict() for check in checks], stage.table, json=json)
    stage.refuse_failed(checks)
