"""A job is what every stage is given; a step is the one artifact that a stage makes of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from elast_cli.errors import UnavailableError, UsageError
from elast_cli.layers import DEFAULT, DataSections
from elast_cli.progress import Progress, Silent
from elast_cli.store.manifest import JsonDict, Recipe, Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

if TYPE_CHECKING:
    from elast_cli.methods.table import Method
    from elast_cli.preset import Preset


@dataclass(frozen=True)
class DataJob:
    """One environment, preset and seed, and how to run: as much as a dataset needs.

    Attributes:
        store: where artifacts are.
        env: the environment's name.
        preset: the preset's name, part of the lineage.
        config: its sections that data depend on, `--set` included.
        seed: of data, training and planner; part of the lineage.
        device: "cpu" or "cuda", resolved; part of the recipe of whatever torch computes.
        threads: torch threads a process; part of such recipes too.
        workers: processes; never changes a result.
        progress: who watches.
        given: artifacts named on the command line, by role.
        wait: wait for another process that makes the same artifact.
        force: make it again even if it is there.
        fresh: forget what an interrupted run had done.
    """

    store: Store
    env: str
    preset: str
    config: DataSections
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    workers: int = 1
    progress: Progress = field(default_factory=Silent)
    given: Mapping[str, Ref] = field(default_factory=dict)
    wait: bool = True
    force: bool = False
    fresh: bool = False

    def flags(self) -> str:
        """The flags that lead another command to the same lineage."""
        words = f"--env {self.env}"
        words += f" --preset {self.preset}" if self.preset != DEFAULT else ""
        return words + (f" --seed {self.seed}" if self.seed else "")

    def recipe(
        self,
        kind: str,
        config: JsonDict,
        inputs: Mapping[str, Ref],
        *,
        algorithm_version: int,
        by_torch: bool = True,
    ) -> Recipe:
        """The recipe of an artifact; what torch does not compute is the same on every device."""
        return Recipe(
            kind=kind,
            env=self.env,
            seed=self.seed,
            preset=self.preset,
            config=config,
            parents={role: self.store.digest(ref) for role, ref in inputs.items()},
            device=self.device if by_torch else "cpu",
            threads=self.threads if by_torch else 1,
            algorithm_version=algorithm_version,
        )


@dataclass(frozen=True)
class Job(DataJob):
    """The same with all sections of the preset."""

    config: Preset


@dataclass(frozen=True)
class Step:
    """How one artifact is made: its recipe, its inputs, and the function that fills its folder.

    `make` writes the artifact's files into `run.staging`, keeps resumable state in `run.work`, and
    returns the metrics for the manifest.
    """

    job: DataJob
    recipe: Recipe
    inputs: Mapping[str, Ref]
    make: Callable[[Run], JsonDict]

    def published(self) -> Ref | None:
        """The artifact, if it was made before and is not to be made again."""
        return None if self.job.force else self.job.store.find(self.recipe)

    def carry_out(self) -> Ref:
        """The artifact, made now unless it was made before.

        Raises:
            BusyError: another process makes it, and the job does not wait.
            StorageError: the disk is full or failing.
        """
        job = self.job
        with job.store.begin(
            self.recipe,
            parents=self.inputs,
            wait=job.wait,
            force=job.force,
            on_wait=job.progress.note,
        ) as run:
            if run.published:
                job.progress.note(f"{run.published} is there already, made by the same recipe")
                return run.published
            if job.fresh:
                run.fresh()
            return run.publish(self.make(run))


def resolve_device(device: str) -> str:
    """`cpu` or `cuda` for auto, cpu or cuda.

    Raises:
        UsageError: another word.
        UnavailableError: cuda, where torch sees no CUDA device.
    """
    if device not in ("auto", "cpu", "cuda"):
        raise UsageError(f"unknown device {device!r}; choose auto, cpu or cuda")
    if device == "cpu":
        return device
    import torch

    if torch.cuda.is_available():
        return "cuda"
    if device == "cuda":
        raise UnavailableError("torch sees no CUDA device; use --device cpu, or see: elast doctor")
    return "cpu"


def note_if_unrepeatable(job: Job, method: Method) -> None:
    """Say so if a method's plans depend on how fast this machine happens to be."""
    if not method.repeatable(job.config):
        budget = job.config.planner.time_budget
        job.progress.note(f"{method.name}: plans of at most {budget:g} s each are not repeatable")


def limit_threads(threads: int) -> None:
    """Let torch use that many threads in this process; one is fastest on a busy machine."""
    import torch

    torch.set_num_threads(threads)
