"""`elast table` and `elast ablate`: many evaluations by one command, as one table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from elast_cli.cli import completion
from elast_cli.cli.jobs import job_of, note, unused
from elast_cli.cli.options import Env, Levels, Lineage, Output, Running, Scenarios, takes
from elast_cli.cli.output import print_json, print_text

HERE = Path()
_LIST_OF_METHODS: Any = {"metavar": "A,B", "autocompletion": completion.lists_of_methods}
Envs = Annotated[str | None, Option(metavar="A,B", help="Environments; default: all of Table 1.")]
Rows = Annotated[str | None, Option(help="Methods; default: those of Table 1.", **_LIST_OF_METHODS)]
OnlyStored = Annotated[
    bool, Option("--only-stored", help="Make nothing: a table of what is in the store.")
]
Varied = Annotated[str, Option(help="Methods to vary, separated by commas.", **_LIST_OF_METHODS)]
Sweeps = Annotated[
    str | None, Option(metavar="A,B", help="Named sweeps: switches, p-sparse, members, vae.")
]
Vary = Annotated[
    list[str] | None,
    Option(metavar="KEY=A,B", help="Values of a key, one after another; may be repeated."),
]


@takes(Scenarios, Lineage, Running)
def table(
    scenarios: Scenarios,
    lineage: Lineage,
    running: Running,
    envs: Envs = None,
    methods: Rows = None,
    only_stored: OnlyStored = False,
    output: Output = HERE,
) -> None:
    """Make Table 1 of the paper: all methods in all tasks. Finished artifacts are reused."""
    from elast_cli.cli.dry_run import show_chain
    from elast_cli.evaluation.table1 import markdown
    from elast_cli.stages import table1 as stage
    from elast_cli.stages import wanted
    from elast_cli.stages.benchmark import training_seeds

    seeds = training_seeds(scenarios.seeds, lineage.seed)
    names, tasks = stage.methods(methods), stage.environments(envs)
    extra = scenarios.overrides()
    jobs = [job_of(env, lineage, running, extra) for env in tasks]
    note(jobs[0], unused(lineage, extra, stage.sections(names)))
    every = stage.evaluations(jobs, names, seeds)
    if running.dry_run:
        show_chain(wanted.planned(every), json=running.json)
        return
    found = wanted.Found([], [])
    if only_stored:
        cells = stage.stored(every)
    else:
        found = wanted.make(every)
        cells = stage.made(every, found.refs)
    entries = stage.entries(jobs[0].store, cells, tasks, names)
    records = [entry.record(lineage.preset) for entry in entries]
    _show("table1", records, markdown(entries, lineage.preset, seeds), output, running)
    found.refuse_failures()


@takes(Scenarios, Lineage, Running)
def ablate(
    env: Env,
    scenarios: Scenarios,
    lineage: Lineage,
    running: Running,
    methods: Varied = "elast,elast-psi",
    level: Levels = None,
    sweep: Sweeps = None,
    vary: Vary = None,
    output: Output = HERE,
) -> None:
    """Compare variations of methods with the methods as they are, on the same scenarios."""
    from elast_cli.cli.dry_run import show_chain
    from elast_cli.evaluation.ablations import markdown
    from elast_cli.stages import ablate as stage
    from elast_cli.stages import sweeps, wanted
    from elast_cli.stages.benchmark import Benchmark

    variations = sweeps.variations(sweep, vary or [])
    bench = Benchmark.parse(methods, level, scenarios.seeds, lineage.seed, [])
    extra = scenarios.overrides()
    job = job_of(env, lineage, running, extra)
    bench.having_levels([job])
    note(job, unused(lineage, extra, bench.sections(make=True)))
    cases = stage.cases(job, bench, variations)
    every = [one for case in cases for one in case.evaluations]
    if running.dry_run:
        show_chain(wanted.planned(every), json=running.json)
        return
    found = wanted.make(every)
    lines = stage.lines(job.store, cases, found.refs)
    records = [line.record(lineage.preset) for line in lines]
    text = markdown(lines, env, lineage.preset, bench.seeds)
    _show(f"ablations-{env}", records, text, output, running)
    found.refuse_failures()


def _show(
    name: str, records: Sequence[dict[str, Any]], text: str, output: Path, running: Running
) -> None:
    """Write a table as CSV and as Markdown, and print it.

    Args:
        name: of the files.
        records: rows of the table.
        text: the table in Markdown.
        output: folder.
        running: whether to print JSON.
    """
    from elast_cli.evaluation.documents import csv_text
    from elast_cli.files import storage_errors, whole_file

    with storage_errors():
        output.mkdir(parents=True, exist_ok=True)
        for ending, content in (("csv", csv_text(records)), ("md", text)):
            with whole_file(output / f"{name}.{ending}") as file:
                file.write(content.encode())
    print_json(list(records)) if running.json else print_text(text.rstrip())
