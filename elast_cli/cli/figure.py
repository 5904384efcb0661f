"""`elast figure`, and the flags of single figures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any

import typer
from typer import Option

from elast_cli.cli.jobs import finish, job_of, unused
from elast_cli.cli.options import MAX_SEED, Env, Lineage, Override, Running, given, inputs_of, takes
from elast_cli.models.parts import DATASET, PARTS

Inputs: Any = inputs_of([DATASET, *PARTS])


@dataclass(frozen=True)
class OneScenario:
    """Which scenario is planned."""

    level: Annotated[str | None, Option(help="Level; default: the hardest.")] = None
    scenario: Annotated[int, Option(min=0, max=100_000, help="Number of the scenario.")] = 0
    scenario_seed: Annotated[
        int | None, Option(min=0, max=MAX_SEED, help="Seed of the scenarios.")
    ] = None

    def overrides(self) -> list[Override]:
        """What these flags override."""
        return given(("--scenario-seed", "eval.scenario_seed", self.scenario_seed))


@dataclass(frozen=True)
class Drawing:
    """What figures can be told, as text."""

    budgets: Annotated[
        str | None,
        Option(
            metavar="A,B", help="exploration: generated states; default: 1500,4500,9000, rounded."
        ),
    ] = None
    p_sparse: Annotated[
        str | None, Option(metavar="A,B", help="sparse: values; default: 0,0.4,0.78.")
    ] = None
    radius: Annotated[
        str | None, Option(metavar="STEPS", help="reachability: in median steps; default: 2.")
    ] = None
    state: Annotated[
        str | None,
        Option(
            metavar="X,Y",
            help="reachability: true state whose nearest training state is taken; default: start.",
        ),
    ] = None


@takes(Inputs, OneScenario, Drawing, Lineage, Running)
def figure(
    name: Annotated[str, typer.Argument(metavar="exploration|reachability|sparse|paths")],
    env: Env,
    inputs: Inputs,
    one: OneScenario,
    drawing: Drawing,
    lineage: Lineage,
    running: Running,
) -> None:
    """Draw one of the paper's figures of the latent space, as PNG and JSON; print its path."""
    from elast_cli.stages.figures import table as stage

    settings = stage.read_settings(name, asdict(drawing))
    extra = one.overrides()
    job = job_of(env, lineage, running, extra, asdict(inputs))
    level = one.level or job.task_info.hardest.name
    wanted = stage.recipe_job(job, name, settings, level, one.scenario)
    notes = unused(lineage, extra, ("env", "eval", *stage.sections(name)))
    finish(wanted, running, notes, stage.document, text=stage.picture)
