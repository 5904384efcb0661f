"""`elast plan`: its flags, and the job that they describe."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from elast_cli.cli import completion
from elast_cli.cli.jobs import finish, job_of, unused
from elast_cli.cli.options import (
    MAX_SEED,
    Lineage,
    Override,
    Running,
    Searching,
    given,
    inputs_of,
    takes,
)
from elast_cli.cli.sharing import unpacked
from elast_cli.errors import UsageError
from elast_cli.models.parts import DATASET, PARTS

if TYPE_CHECKING:
    from elast_cli.stages.job import Job
    from elast_cli.stages.problem import Problem
    from elast_cli.store.bundle import Contents

PlanInputs: Any = inputs_of([DATASET, *PARTS])
METHOD = "elast"


@dataclass(frozen=True)
class Scene:
    """What is planned: a scenario, or images."""

    level: Annotated[str | None, typer.Option(help="Level; default: the hardest.")] = None
    scenario: Annotated[
        int | None,
        typer.Option(min=0, max=100_000, help="Number of the scenario; default: 0."),
    ] = None
    scenario_seed: Annotated[
        int | None, typer.Option(min=0, max=MAX_SEED, help="Seed of the scenarios.")
    ] = None
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="IMAGE",
            help="Plan from this image; up to three times: frames, the oldest first.",
        ),
    ] = None
    goal: Annotated[
        list[str] | None, typer.Option(metavar="IMAGE", help="Plan to this image; likewise.")
    ] = None
    context_image: Annotated[
        str | None,
        typer.Option(metavar="IMAGE", help="The obstacles, where they change with the episode."),
    ] = None

    def overrides(self) -> list[Override]:
        """What these flags override."""
        return given(("--scenario-seed", "eval.scenario_seed", self.scenario_seed))

    def problem(self, job: Job) -> Problem:
        """What these flags ask for, in the job's task."""
        from elast_cli.stages import problem

        if not (self.start or self.goal or self.context_image):
            level = self.level or job.task_info.hardest.name
            return problem.of_scenario(job, level, self.scenario or 0)
        scene = (self.level, self.scenario, self.scenario_seed)
        if any(value is not None for value in scene):
            raise UsageError("images stand for a scenario: leave out --level and --scenario")
        return problem.of_images(job, self.start or [], self.goal or [], self.context_image)


@dataclass(frozen=True)
class Source:
    """Where the models come from: a store, or a bundle."""

    env: Annotated[
        str | None,
        typer.Option(
            "--env",
            metavar="NAME",
            help="Environment; a bundle names its own.",
            autocompletion=completion.environments,
        ),
    ] = None
    method: Annotated[
        str | None,
        typer.Option(
            help="A method that grows a tree; default: elast, or that of the bundle.",
            autocompletion=completion.growing_trees,
        ),
    ] = None
    models: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A bundle to unpack and to plan with: parts, preset, seed and settings.",
        ),
    ] = None

    def job(
        self,
        lineage: Lineage,
        running: Running,
        extra: list[Override],
        parts: dict[str, str | None],
    ) -> tuple[Job, str]:
        """The job and the method.

        Args:
            lineage: preset, overrides, seed; of a bundle's, `--set` alone counts.
            running: how to run.
            extra: what other flags override.
            parts: refs of single parts.
        """
        if self.models:
            found = self._unpacked(self.models, parts, running)
            return _bundled(found, lineage, running, extra), found.method
        if self.env is None:
            raise UsageError("--env or --models is needed; see: elast plan --help")
        return job_of(self.env, lineage, running, extra, parts), self.method or METHOD

    def _unpacked(self, path: Path, parts: dict[str, str | None], running: Running) -> Contents:
        """What a bundle holds. Raises UsageError if other flags ask for something else."""
        if running.dry_run:
            raise UsageError(f"--dry-run writes nothing; first run: elast unbundle {path}")
        if any(parts.values()):
            raise UsageError("--models names all parts; leave flags of single parts out")
        found = unpacked(path)
        both = (("--env", self.env, found.env), ("--method", self.method, found.method))
        for flag, asked, has in both:
            if asked not in (None, has):
                raise UsageError(f"{flag} {asked}: {path} is of {has}")
        return found


@takes(Source, PlanInputs, Scene, Searching, Lineage, Running)
def plan(
    source: Source,
    inputs: PlanInputs,
    scene: Scene,
    searching: Searching,
    lineage: Lineage,
    running: Running,
) -> None:
    """Plan one scenario, or from image to image, and explain every edge of the plan."""
    from elast_cli.methods.table import method_named
    from elast_cli.stages import plan as stage
    from elast_cli.store.manifest import Ref

    parts = asdict(inputs)
    if parts["context"] and not Ref.maybe(parts["context"]):
        raise UsageError(f"--context {parts['context']}: not a ref; an image: --context-image")
    extra = [*scene.overrides(), *searching.overrides()]
    job, method = source.job(lineage, running, extra, parts)
    wanted = stage.recipe_job(job, method, scene.problem(job))
    uses = ("env", "eval", *method_named(method).sections)
    finish(wanted, running, unused(lineage, extra, uses), stage.document, stage.remark)


def _bundled(found: Contents, lineage: Lineage, running: Running, extra: list[Override]) -> Job:
    """The job that a bundle stands for; `--set` still overrides its settings."""
    from elast_cli import preset
    from elast_cli.stages import sharing

    settings = [*sharing.overrides_of(found), *(lineage.set or [])]
    known = found.preset if found.preset in preset.names() else preset.DEFAULT
    job = job_of(
        found.env,
        replace(lineage, preset=known, seed=found.seed, set=settings),
        running,
        extra,
        sharing.flags_of(found),
    )
    return replace(job, preset=found.preset)
