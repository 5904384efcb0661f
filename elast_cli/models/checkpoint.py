"""The state of a training at one step: saved whole, restored exactly, refused when damaged."""

from __future__ import annotations

import hashlib
import io
import pickle
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from elast_cli.errors import DataError
from elast_cli.files import open_regular, whole_file
from elast_cli.models.part import FitConfig

CHECKPOINT = "checkpoint.pt"  # a SHA-256 in hexadecimal and a line feed, then what torch saves
_DIGEST = 65
# what reading a checkpoint of another model may raise
_MISMATCH = (
    AttributeError,
    EOFError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)


class TrainingState:
    """Model, optimizer and schedule at one step, saved and restored together.

    Attributes:
        step: gradient steps done.
        rows: metrics logged so far.
    """

    def __init__(self, module: nn.Module, config: FitConfig, work: Path) -> None:
        """Begin at step 0 with a new optimizer and schedule.

        Args:
            module: what is trained, on its device.
            config: steps, learning rate and weight decay.
            work: folder of the checkpoint.
        """
        self.module, self.path = module, work / CHECKPOINT
        parameters = [p for p in module.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(
            parameters, lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(
            self.optimizer, max_lr=config.learning_rate, total_steps=config.steps + 1
        )
        self.step = 0
        self.rows: list[dict[str, float]] = []

    @property
    def learning_rate(self) -> float:
        """The rate of the next step."""
        return float(self.optimizer.param_groups[0]["lr"])

    def advance(self, loss: Tensor) -> None:
        """One gradient step."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()
        self.schedule.step()
        self.step += 1

    def save_if(self, due: bool) -> None:
        """Save where that is due."""
        if due:
            self.save()

    def save(self) -> None:
        """Put the state on disk in place of the last checkpoint, whole or not at all."""
        state = {
            "model": self.module.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "schedule": self.schedule.state_dict(),
            "step": self.step,
            "rows": self.rows,
        }
        content = io.BytesIO()
        torch.save(state, content)
        with whole_file(self.path) as file:
            file.write(hashlib.sha256(content.getbuffer()).hexdigest().encode() + b"\n")
            file.write(content.getbuffer())

    def restore(self) -> bool:
        """Continue from the last checkpoint of this run; False where there is none.

        Raises:
            DataError: the checkpoint is damaged.
        """
        try:
            with open_regular(self.path) as file:
                stored = file.read()
        except FileNotFoundError:
            return False
        except ValueError as reason:  # a folder, or a FIFO, at which reading would wait for ever
            raise self._damaged(str(reason)) from None
        digest, content = stored[:_DIGEST], stored[_DIGEST:]
        if digest != hashlib.sha256(content).hexdigest().encode() + b"\n":
            raise self._damaged("its SHA-256 differs")
        try:
            state: dict[str, Any] = torch.load(io.BytesIO(content), weights_only=True)
            self.module.load_state_dict(state["model"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.schedule.load_state_dict(state["schedule"])
            self.step, self.rows = state["step"], state["rows"]
        except _MISMATCH as reason:
            raise self._damaged(type(reason).__name__) from None
        return True

    def _damaged(self, reason: str) -> DataError:
        return DataError(
            f"{self.path}: a damaged checkpoint ({reason}); "
            "the same command with --fresh restarts this training"
        )
