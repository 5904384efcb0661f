"""Job: the input of every stage. RecipeJob: one artifact that a stage makes from it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from elast_cli.config import JsonDict
from elast_cli.engine.base import Engine
from elast_cli.engine.local import LocalEngine
from elast_cli.envs.base import TaskInfo
from elast_cli.envs.registry import task_info
from elast_cli.errors import UnavailableError, UsageError
from elast_cli.methods.table import joined
from elast_cli.models.parts import PARTS, closure
from elast_cli.preset import DEFAULT, Preset
from elast_cli.progress import Progress, Silent
from elast_cli.store.manifest import Recipe, Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

if TYPE_CHECKING:
    from elast_cli.methods.table import Method


PLANNER = "planner"  # the section of methods that grow trees


@dataclass(frozen=True)
class Job:
    """One environment, preset and seed, and how to run.

    Attributes:
        store: where artifacts are.
        env: the environment's name.
        preset: the preset's name, part of the lineage.
        config: all its sections, `--set` included.
        seed: of data, training and planner; part of the lineage.
        changes: keys of parts' sections that a method or a sweep changes, by kind; `config` has
            them.
        method: the name of that method.
        device: "cpu" or "cuda", resolved; part of the recipe of whatever torch computes.
        threads: torch threads a process; part of such recipes too.
        workers: processes; never changes a result.
        memory_gb: most memory of a training; never changes a result.
        progress: where progress is shown.
        given: artifacts named on the command line, by role.
        wait: wait for another process that makes the same artifact.
        force: make a new version even if one exists.
        fresh: discard the state of an interrupted run.
    """

    store: Store
    env: str
    preset: str
    config: Preset
    seed: int = 0
    changes: Mapping[str, JsonDict] = field(default_factory=dict)
    method: str = ""
    device: str = "cpu"
    threads: int = 1
    workers: int = 1
    memory_gb: float = 4.0
    progress: Progress = field(default_factory=Silent)
    given: Mapping[str, Ref] = field(default_factory=dict)
    wait: bool = True
    force: bool = False
    fresh: bool = False

    @property
    def engine(self) -> Engine:
        """Where the tasks of this job run."""
        return LocalEngine(self.workers)

    @property
    def task_info(self) -> TaskInfo:
        """Sizes, levels and success of the task."""
        return task_info(self.env, self.config.env)

    def flags(self) -> str:
        """The flags that select the same lineage in another command."""
        words = f"--env {self.config.env.get('id') or self.env}"
        words += f" --preset {self.preset}" if self.preset != DEFAULT else ""
        return words + (f" --seed {self.seed}" if self.seed else "")

    def of_method(self, method: Method) -> Job:
        """The same job with the parts of a method, which may differ from the preset's."""
        changes = method.part_changes
        if not changes:
            return replace(self, method=method.name)
        config = self.config.changed(changes, by=f"method {method.name}")
        both = joined(self.changes, changes)
        return replace(self, config=config, changes=both, method=method.name)

    def variant(self, kind: str) -> JsonDict:
        """What this job changes in a part, or in one that it is made from."""
        if not self.changes or kind not in PARTS:
            return {}
        made_from = closure([kind], has_context=self.task_info.has_context)
        return {part: self.changes[part] for part in made_from if part in self.changes}

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
            variant=self.variant(kind),
            device=self.device if by_torch else "cpu",
            threads=self.threads if by_torch else 1,
            algorithm_version=algorithm_version,
        )


@dataclass(frozen=True)
class RecipeJob:
    """How one artifact is made: its recipe, its inputs, and the function that fills its folder.

    `make` writes the artifact's files into `run.staging`, keeps resumable state in `run.work`, and
    returns the metrics for the manifest.
    """

    job: Job
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
                job.progress.note(f"{run.published} already exists, made by the same recipe")
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
    if device == "cpu" or (device == "auto" and not _has_cuda_driver()):
        return "cpu"
    import torch

    if torch.cuda.is_available():
        return "cuda"
    if device == "cuda":
        raise UnavailableError("torch sees no CUDA device; use --device cpu, or see: elast doctor")
    return "cpu"


def _has_cuda_driver() -> bool:
    """Whether there may be a CUDA device; torch, which knows, takes seconds to import."""
    if sys.platform != "linux":
        return True
    return any(os.path.exists(path) for path in ("/dev/nvidiactl", "/dev/dxg"))  # dxg: WSL


def time_budget(job: Job, method: Method) -> float | None:
    """Seconds that a plan may take at most: such plans are not repeatable. None: any time."""
    if PLANNER not in method.sections:
        return None
    budget = method.configure(job.config).plain(PLANNER)["time_budget"]
    return None if budget is None else float(str(budget))


def note_if_unrepeatable(job: Job, method: Method) -> None:
    """Note if a method's plans depend on the speed of this machine."""
    budget = time_budget(job, method)
    if budget is not None:
        job.progress.note(f"{method.name}: plans of at most {budget:g} s each are not repeatable")


def limit_threads(threads: int) -> None:
    """Limit torch to some threads in this process; one is fastest on a busy machine."""
    import torch

    torch.set_num_threads(threads)


def verify_files(store: Store, inputs: Mapping[str, Ref]) -> None:
    """Raise DataError unless every file of every input is as its manifest says."""
    for ref in inputs.values():
        for name in store.manifest(ref).files:
            store.file(ref, name)
