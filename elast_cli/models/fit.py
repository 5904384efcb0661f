"""The only training loop: Adam with a one-cycle rate, resumable at any step.

A batch is a pure function of (seed, part, step), so a killed run that resumes from its last
checkpoint ends with the same weights as one that was never interrupted.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.errors import DataError
from elast_cli.models.checkpoint import TrainingState
from elast_cli.models.part import FitConfig, Setting, stream
from elast_cli.models.precision import resolved
from elast_cli.seeding import generator

Loss = Callable[[np.random.Generator], tuple[Tensor, Mapping[str, Tensor]]]
Validate = Callable[[], Mapping[str, float]]

METRICS = "metrics.csv"
EVENTS = "events.out.tfevents.elast"


def fit(
    kind: str,
    module: nn.Module,
    loss: Loss,
    validate: Validate,
    *,
    config: FitConfig,
    setting: Setting,
) -> list[dict[str, float]]:
    """Train `module`, on its device, in place: rows of metrics, one per `log_every` steps.

    Args:
        kind: of the part; names its random stream and its progress bar.
        module: what to train.
        loss: draws a batch from a generator and returns the loss and its parts.
        validate: metrics on held-out data, called at every logged step.
        config: steps, rate, intervals.
        setting: seed, folder, progress.

    Raises:
        DataError: the loss is not finite, or the checkpoint is damaged.
    """
    state, progress = TrainingState(module, config, setting.work), setting.progress
    low = resolved(config.precision, setting.device.type) == "bfloat16"
    if state.restore():
        progress.note(f"{kind}: resuming at step {state.step} of {config.steps}")
    module.train()
    with progress.task(kind, config.steps, state.step) as advance:
        while state.step < config.steps:
            with torch.autocast(setting.device.type, torch.bfloat16, enabled=low):
                value, parts = loss(generator("train", setting.seed, stream(kind), state.step))
            _refuse_infinite(kind, value, state)
            state.advance(value)
            advance(1)
            last = state.step == config.steps
            if last or state.step % config.log_every == 0:
                state.rows.append(_row(state.step, value, parts, validate))
            state.save_if(not last and state.step % config.save_every == 0)
    _finish(module, rounded=low)
    return state.rows


def _finish(module: nn.Module, *, rounded: bool) -> None:
    """Make a trained module ready for inference; perhaps with rounded weights."""
    if rounded:
        round_weights(module)
    module.eval()


def _refuse_infinite(kind: str, value: Tensor, state: TrainingState) -> None:
    """Raise DataError if a loss is not finite; the last checkpoint stays."""
    if not torch.isfinite(value):
        raise DataError(
            f"{kind}: the loss is {value.item()} at step {state.step}, learning rate "
            f"{state.learning_rate:.2g}; lower it: --set {kind}.fit.learning_rate=... --fresh"
        )


@torch.no_grad()
def round_weights(module: nn.Module) -> None:
    """Round trained parameters to bfloat16; they stay float32."""
    for parameter in module.parameters():
        parameter.copy_(parameter.bfloat16())


def _row(
    step: int, value: Tensor, parts: Mapping[str, Tensor], validate: Validate
) -> dict[str, float]:
    train = {f"train_{name}": part.item() for name, part in parts.items()}
    with torch.no_grad():
        held_out = {f"val_{name}": number for name, number in validate().items()}
    return {"step": step, "train_loss": value.item(), **train, **held_out}


def write_metrics(rows: list[dict[str, float]], folder: Path) -> None:
    """Write the training curve as CSV and as a TensorBoard event file into `folder`."""
    with (folder / METRICS).open("x", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    with (folder / EVENTS).open("xb") as file:
        _write_events(rows, file)


def _write_events(rows: list[dict[str, float]], file: BinaryIO) -> None:
    """The curve for TensorBoard; steps stand for times, so that equal curves are equal files."""
    from tensorboard.compat.proto.event_pb2 import Event  # slow to import: only where it is used
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.summary.writer.record_writer import RecordWriter

    events = [Event(file_version="brain.Event:2")]
    for row in rows:
        step = int(row["step"])
        values = [
            Summary.Value(tag=name, simple_value=value)
            for name, value in row.items()
            if name != "step"
        ]
        events.append(Event(wall_time=step, step=step, summary=Summary(value=values)))
    writer = RecordWriter(file)
    for event in events:
        writer.write(event.SerializeToString())
