"""What each learned part is trained on: batches, losses, held-out metrics and calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from pydantic import Field
from torch import nn

from elast_cli.config import StrictModel
from elast_cli.progress import Progress
from elast_cli.seeding import derived_seed

_MAX_WIDTH = 1 << 20


class Sizes(StrictModel):
    """What a model's shape depends on besides its configuration."""

    latent: int = Field(gt=0, le=_MAX_WIDTH)
    action: int = Field(gt=0, le=_MAX_WIDTH)
    context: int = Field(ge=0, le=_MAX_WIDTH)
    state: int = Field(gt=0, le=_MAX_WIDTH)


STAGES = {"encoder": 1, "ensemble": 2, "density": 3, "policy": 4, "context": 5}


@dataclass(frozen=True)
class Trained:
    """A trained module with its training curve and final metrics."""

    module: nn.Module
    sizes: Sizes | None
    curve: list[dict[str, float]]
    metrics: dict[str, float]


@dataclass(frozen=True)
class Setting:
    """Where and how a training runs; the same for every part."""

    seed: int
    work: Path
    device: torch.device
    progress: Progress
    validation_share: float = 0.1


def seed_torch(seed: int, stage: str) -> None:
    """Make the initial weights a function of (seed, stage)."""
    torch.manual_seed(derived_seed("train", seed, STAGES[stage]))
