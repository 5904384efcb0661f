"""`elast train-*`: one learned part each, resumable at any step."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from elast_cli.config import JsonDict
from elast_cli.errors import DataError, StorageError
from elast_cli.memory import available, peak
from elast_cli.models.parts import CONTEXT, DATASET, part_named
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.differences import WITHOUT_EFFECT
from elast_cli.stages.job import Job, RecipeJob, limit_threads, verify_files
from elast_cli.stages.resolve import needs, refuse_without_context, resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run

if TYPE_CHECKING:
    from elast_cli.data.dataset import Dataset
    from elast_cli.models.part import Reconstructions, Setting

ALGORITHM_VERSION = 1
ROOM, ROW_BYTES = 0.2e9, 300  # of networks and batches, and of a frame's numbers, latents and rows
LEAST_TRANSITIONS = 200  # a tenth is held out, and the ensemble keeps 100 states at least
RECONSTRUCTIONS_FILE = "reconstructions.png"


def recipe_job(job: Job, kind: str) -> RecipeJob:
    """One learned part, on the artifacts that the job names or that fit.

    Raises:
        MissingInputError: an input is not made yet.
        DataError: the inputs named are of different lineages.
        UsageError: an unknown part, or a context where the environment has none.
    """
    part_named(kind)
    if kind == CONTEXT:
        refuse_without_context(job)
    inputs = resolve(job, needs(job, kind))
    config: JsonDict = {"env": job.config.env, kind: _settings(job, kind)}
    recipe = job.recipe(kind, config, inputs, algorithm_version=ALGORITHM_VERSION)
    return RecipeJob(job, recipe, inputs, lambda run: _train(job, kind, inputs, run))


def _settings(job: Job, kind: str) -> JsonDict:
    """The part's section, without keys that change no weight."""
    section = job.config.section(kind, part_named(kind).section).determining()
    fit = section.get("fit")
    if not isinstance(fit, dict):  # nothing is fitted
        return section
    silent = {key.removeprefix("fit.") for key in WITHOUT_EFFECT}
    return {**section, "fit": {key: value for key, value in fit.items() if key not in silent}}


def _train(job: Job, kind: str, inputs: Mapping[str, Ref], run: Run) -> JsonDict:
    from elast_cli.data.dataset import Dataset
    from elast_cli.models.files import save_model
    from elast_cli.models.fit import write_metrics
    from elast_cli.models.inputs import Inputs
    from elast_cli.models.outputs import Outputs
    from elast_cli.models.part import Section
    from elast_cli.models.precision import resolved

    began, cpu = time.monotonic(), time.process_time()
    limit_threads(job.threads)
    verify_files(job.store, inputs)
    dataset = Dataset.load(job.store.file(inputs[DATASET], DATASET_FILE))
    _check_contexts(job, inputs[DATASET], dataset)
    _check_size(job, inputs[DATASET], dataset)
    setting = _setting(job, run, len(dataset.action))
    folders = {role: job.store.path(ref) for role, ref in inputs.items() if role != DATASET}
    part = part_named(kind)
    with _disk_errors():
        section = job.config.section(kind, part.section)
        outputs = Outputs(job.store.cache, job.store.digest(inputs[DATASET]))
        trained = part.train(Inputs(dataset, folders, setting, outputs), section, setting)
        save_model(run.staging, trained)
        write_metrics(trained.curve, run.staging)
    if trained.reconstructions:
        _draw(trained.reconstructions, run.staging / RECONSTRUCTIONS_FILE)
    metrics: JsonDict = {**trained.metrics}
    if isinstance(section, Section):
        metrics["precision"] = resolved(section.fit.precision, job.device)
    return {
        **metrics,
        "wall_s": round(time.monotonic() - began, 3),
        "cpu_s": round(time.process_time() - cpu, 3),
        "peak_memory_gb": round(peak() / 1e9, 3),  # of the process, with all that it did before
    }


def _draw(shown: Reconstructions, path: Path) -> None:
    """Images above what a part makes of them."""
    from elast_cli.pictures.film import reconstruction_grid

    reconstruction_grid(shown.images, shown.decoded, path, labels=shown.labels)


def _check_size(job: Job, ref: Ref, dataset: Dataset) -> None:
    """Raise DataError if there is too little to train on and to hold out."""
    transitions = int((dataset.ep_len - 1).sum())
    run = f"run: elast collect {job.flags()} --n {max(LEAST_TRANSITIONS, 2 * transitions)}"
    if dataset.episodes < 2:
        raise DataError(f"{ref}: it has one episode, and training holds one out; {run}")
    if transitions < LEAST_TRANSITIONS:
        raise DataError(
            f"{ref}: {transitions} transitions are too few: training takes at least "
            f"{LEAST_TRANSITIONS}; {run}"
        )


def memory(job: Job, rows: float) -> tuple[float, float]:
    """Bytes that a training on `rows` frames needs at least, and how many more it may take.

    The latter are negative if there are too few.
    """
    need = ROOM + rows * ROW_BYTES
    return need, min(job.memory_gb * 1e9, available() - need)


def _setting(job: Job, run: Run, rows: int) -> Setting:
    """How to train on `rows` frames, with the memory that is free for images.

    Raises:
        StorageError: there is less than a training needs.
    """
    import torch

    from elast_cli.models.part import Setting

    need, spare = memory(job, rows)
    if spare < 0:
        raise StorageError(
            f"training on {rows:,} frames takes {need / 1e9:.1f} GB of memory, "
            f"{(need + spare) / 1e9:.1f} GB "
            "are free: stop other programs, raise the limit (ulimit -v), or collect fewer (--n)"
        )
    return Setting(
        seed=job.seed,
        work=run.work,
        device=torch.device(job.device),
        progress=job.progress,
        memory_gb=spare / 1e9,
    )


def _check_contexts(job: Job, ref: Ref, dataset: Dataset) -> None:
    """Raise DataError unless the dataset has the context images that its environment shows."""
    from elast_cli.shapes import IMAGE_SIZE

    shape = (IMAGE_SIZE, IMAGE_SIZE, 3) if job.task_info.has_context else None
    found = None if dataset.context is None else dataset.context.shape[1:]
    if found != shape:
        raise DataError(
            f"{ref}: context images of shape {found}, but {job.env} has {shape}; "
            f"collect it again: elast collect {job.flags()} --force"
        )


@contextmanager
def _disk_errors() -> Iterator[None]:
    """Turn disk errors of torch and safetensors into OSError."""
    from safetensors import SafetensorError

    try:
        yield
    except RuntimeError as error:  # torch.save fails once more while it closes the file
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None
        if "not enough memory" in str(error):  # torch's allocator
            raise MemoryError from None
        raise
    except SafetensorError as error:
        found = re.search(r"os error (\d+)", str(error))
        if found:
            raise OSError(int(found[1]), os.strerror(int(found[1]))) from None
        raise
