"""The only training loop: Adam with a one-cycle rate, resumable at any step.

A batch is a pure function of (seed, stream, step), so a killed run that resumes from its last
checkpoint ends with the same weights as one that was never interrupted.
"""

from __future__ import annotations

import csv
import io
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.errors import DataError
from elast_cli.files import whole_file
from elast_cli.models.part import FitConfig
from elast_cli.progress import Progress
from elast_cli.seeding import generator

Loss = Callable[[np.random.Generator], tuple[Tensor, Mapping[str, Tensor]]]
Validate = Callable[[], Mapping[str, float]]

CHECKPOINT = "checkpoint.pt"
METRICS = "metrics.csv"
# what reading a damaged checkpoint may raise
_DAMAGE = (
    AttributeError,
    EOFError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)


class _Run:
    """Model, optimizer and schedule at one step, saved and restored together."""

    def __init__(self, module: nn.Module, config: FitConfig, work: Path) -> None:
        self.module, self.config, self.work = module, config, work
        parameters = [p for p in module.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(
            parameters, lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(
            self.optimizer, max_lr=config.learning_rate, total_steps=config.steps + 1
        )
        self.step = 0
        self.rows: list[dict[str, float]] = []

    def save(self) -> None:
        """Write everything beside, flush it to disk, then rename over the last checkpoint."""
        state = {
            "model": self.module.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "schedule": self.schedule.state_dict(),
            "step": self.step,
            "rows": self.rows,
        }
        with whole_file(self.work / CHECKPOINT) as file:
            torch.save(state, file)

    def restore(self) -> bool:
        """Continue from the last checkpoint of this run; False where there is none.

        Raises:
            DataError: the checkpoint is damaged.
        """
        path = self.work / CHECKPOINT
        if not path.exists():
            return False
        content = io.BytesIO(path.read_bytes())  # so that no damage looks like a disk error
        try:
            state: dict[str, Any] = torch.load(content, weights_only=True)
            self.module.load_state_dict(state["model"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.schedule.load_state_dict(state["schedule"])
            self.step, self.rows = state["step"], state["rows"]
        except _DAMAGE as reason:
            raise DataError(
                f"{path}: a damaged checkpoint ({type(reason).__name__}); "
                "the same command with --fresh begins this training anew"
            ) from None
        return True

    def advance(self, loss: Tensor) -> None:
        """One gradient step."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()
        self.schedule.step()
        self.step += 1


def fit(
    module: nn.Module,
    loss: Loss,
    *,
    config: FitConfig,
    seed: int,
    stream: int,
    label: str,
    work: Path,
    validate: Validate,
    progress: Progress,
) -> list[dict[str, float]]:
    """Train `module` in place and return the rows of its metrics, one per `log_every` steps.

    Args:
        module: what to train; moved to its device already.
        loss: draws a batch from the generator it is given and returns the loss and its parts.
        config: steps, rate, intervals.
        seed: the training seed.
        stream: number of the part's random stream, no two parts share one.
        label: what the progress bar says.
        work: folder of this run's checkpoint, kept when the process is killed.
        validate: metrics on held-out data, called at every logged step.
        progress: where steps are shown.
    """
    run = _Run(module, config, work)
    device = next(module.parameters()).device.type
    low = config.precision == "bfloat16"
    if run.restore():
        progress.note(f"{label}: resuming at step {run.step} of {config.steps}")
    module.train()
    with progress.task(label, config.steps) as advance:
        advance(run.step)
        while run.step < config.steps:
            with torch.autocast(device, torch.bfloat16, enabled=low):
                value, parts = loss(generator("train", seed, stream, run.step))
            run.advance(value)
            advance(1)
            if run.step % config.log_every == 0 or run.step == config.steps:
                run.rows.append(_row(run.step, value, parts, validate))
            if run.step % config.save_every == 0 and run.step < config.steps:
                run.save()
    if low:
        round_weights(module)
    module.eval()
    return run.rows


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
    with (folder / METRICS).open("x", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    from torch.utils.tensorboard import SummaryWriter  # slow to import: only where it is used

    with SummaryWriter(str(folder)) as board:
        for row in rows:
            for name, value in row.items():
                if name != "step":
                    board.add_scalar(name, value, int(row["step"]))
    for events in folder.glob("events.out.tfevents.*"):  # named after host and time; drop both
        events.rename(folder / "events.out.tfevents.elast")
