"""`elast train-*`: one learned part each, resumable at any step."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from elast_cli.config import StrictModel
from elast_cli.errors import DataError
from elast_cli.models.fit import write_metrics
from elast_cli.preset import Preset
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.job import Job, Step, limit_threads
from elast_cli.stages.resolve import has_context, needs, refuse_without_context, resolve
from elast_cli.store.manifest import JsonDict, Ref
from elast_cli.store.run import Run

if TYPE_CHECKING:
    from torch import Tensor, nn

    from elast_cli.data.dataset import Dataset
    from elast_cli.models.ensemble.net import DynamicsEnsemble
    from elast_cli.models.latents import LatentData
    from elast_cli.models.part import Setting, Trained

ALGORITHM_VERSION = 1
CONTEXT_PICTURE = "reconstructions.png"
MOST_CONTEXTS = 10  # in the picture


def section(config: Preset, kind: str) -> StrictModel:
    """The configuration of one learned part."""
    found: StrictModel = getattr(config, kind)
    return found


def step(job: Job, kind: str) -> Step:
    """One learned part, on the artifacts that the job names or that fit.

    Raises:
        MissingInputError: an input is not made yet.
        DataError: the inputs named are of different lineages.
        UsageError: a context, where the environment has none.
    """
    if kind == "context":
        refuse_without_context(job.env)
    inputs = resolve(job, needs(job.env, kind))
    config: JsonDict = {kind: section(job.config, kind).model_dump(mode="json")}
    recipe = job.recipe(kind, config, inputs, algorithm_version=ALGORITHM_VERSION)
    return Step(job, recipe, inputs, lambda run: _train(job, kind, inputs, run))


def load(job: Job, kind: str, ref: Ref) -> nn.Module:
    """A learned part, after its files were verified.

    Raises:
        DataError: a file was changed, or is no model of that kind.
    """
    from elast_cli.models.files import load_model

    for name in job.store.manifest(ref).files:
        job.store.file(ref, name)
    return load_model(job.store.path(ref), kind)


def _train(job: Job, kind: str, inputs: Mapping[str, Ref], run: Run) -> JsonDict:
    import torch

    from elast_cli.data.dataset import Dataset
    from elast_cli.models.files import save_model
    from elast_cli.models.part import Setting

    began, cpu = time.monotonic(), time.process_time()
    limit_threads(job.threads)
    dataset = Dataset.load(job.store.file(inputs["dataset"], DATASET_FILE))
    _check_contexts(job, inputs["dataset"], dataset)
    setting = Setting(
        seed=job.seed, work=run.work, device=torch.device(job.device), progress=job.progress
    )
    with _disk_errors(run):
        trained = _TRAINERS[kind](job, inputs, dataset, setting)
        save_model(run.staging, trained.module, sizes=trained.sizes)
        write_metrics(trained.curve, run.staging)
        if kind == "context":
            _draw_contexts(trained.module, dataset, setting, run.staging / CONTEXT_PICTURE)
    metrics: JsonDict = {**trained.metrics}
    metrics["wall_s"] = round(time.monotonic() - began, 3)
    metrics["cpu_s"] = round(time.process_time() - cpu, 3)
    return metrics


def _check_contexts(job: Job, ref: Ref, dataset: Dataset) -> None:
    """Raise DataError unless the dataset has the context images that its environment shows."""
    from elast_cli.shapes import IMAGE_SIZE

    shape = (IMAGE_SIZE, IMAGE_SIZE, 3) if has_context(job.env) else None
    found = None if dataset.context is None else dataset.context.shape[1:]
    if found != shape:
        raise DataError(
            f"{ref}: context images of shape {found}, but {job.env} has {shape}; "
            f"collect it anew: elast collect {job.flags()} --force"
        )


def _context(job: Job, inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting) -> Tensor:
    """Context vector of each episode [E,C]; C = 0 where the environment has none."""
    import torch

    from elast_cli.models.context.net import ContextAutoencoder, context_vectors

    if dataset.context is None:
        return torch.zeros(dataset.episodes, 0)
    model = load(job, "context", inputs["context"]).to(setting.device)
    assert isinstance(model, ContextAutoencoder)
    return torch.from_numpy(context_vectors(model, dataset.context))


def _draw_contexts(module: nn.Module, dataset: Dataset, setting: Setting, path: Path) -> None:
    """A few held-out context images above what the autoencoder makes of them."""
    from elast_cli.models.context.net import ContextAutoencoder, reconstructions
    from elast_cli.pictures.film import reconstruction_strip

    assert isinstance(module, ContextAutoencoder)
    assert dataset.context is not None
    _, held_out = dataset.split(setting.validation_share, setting.seed)
    shown = held_out[:MOST_CONTEXTS]
    images = dataset.context[shown]
    reconstruction_strip(images, reconstructions(module, images), path, labels=shown.tolist())


@contextmanager
def _disk_errors(run: Run) -> Iterator[None]:
    """A disk error as OSError, whatever torch and safetensors make of it."""
    from safetensors import SafetensorError

    try:
        yield
    except RuntimeError as error:  # torch.save fails once more while it closes the file
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None
        raise
    except SafetensorError as error:
        found = re.search(r"os error (\d+)", str(error))
        if found:
            raise OSError(int(found[1]), os.strerror(int(found[1]))) from None
        raise


# --- one trainer a part --------------------------------------------------------------------------

_Trainer = Callable[[Job, Mapping[str, Ref], "Dataset", "Setting"], "Trained"]


def _context_images(
    job: Job, _inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting
) -> Trained:
    from elast_cli.models.context.training import train_context

    assert dataset.context is not None
    split = dataset.split(setting.validation_share, setting.seed)
    return train_context(dataset.context, split, job.config.context, setting)


def _encoder(job: Job, inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting) -> Trained:
    from elast_cli.models.encoder.training import train_encoder

    context = _context(job, inputs, dataset, setting)
    return train_encoder(dataset, context, job.config.encoder, setting)


def _ensemble(job: Job, inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting) -> Trained:
    from elast_cli.models.ensemble.training import train_ensemble

    data = _encoded(job, inputs, dataset, setting)
    return train_ensemble(data, job.config.ensemble, setting)


def _density(job: Job, inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting) -> Trained:
    from elast_cli.models.density.training import train_density

    data = _encoded(job, inputs, dataset, setting)
    dynamics = _dynamics(job, inputs, setting) if "ensemble" in inputs else None
    return train_density(data, job.config.density, setting, dynamics)


def _policy(job: Job, inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting) -> Trained:
    from elast_cli.models.policy.training import train_policy

    data = _encoded(job, inputs, dataset, setting)
    return train_policy(data, _dynamics(job, inputs, setting), job.config.policy, setting)


def _dynamics(job: Job, inputs: Mapping[str, Ref], setting: Setting) -> DynamicsEnsemble:
    from elast_cli.models.ensemble.support import SupportedDynamics

    model = load(job, "ensemble", inputs["ensemble"]).to(setting.device)
    assert isinstance(model, SupportedDynamics)
    return model.ensemble


def _encoded(job: Job, inputs: Mapping[str, Ref], dataset: Dataset, setting: Setting) -> LatentData:
    from elast_cli.models.encoder.cpc import Representation
    from elast_cli.models.encoder.encode import encode

    model = load(job, "encoder", inputs["encoder"]).to(setting.device)
    assert isinstance(model, Representation)
    return encode(dataset, _context(job, inputs, dataset, setting), model, setting)


_TRAINERS: Mapping[str, _Trainer] = {
    "context": _context_images,
    "encoder": _encoder,
    "ensemble": _ensemble,
    "density": _density,
    "policy": _policy,
}
