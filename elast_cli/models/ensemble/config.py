"""Configuration of the dynamics ensemble H_f."""

from __future__ import annotations

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_WIDTH, FitConfig, Section


class EnsembleConfig(StrictModel):
    """Size of H_f; m is not stated in the paper's main text."""

    members: int = Field(default=5, ge=1, le=100)
    width: int = Field(default=128, gt=0, le=MAX_WIDTH)
    depth: int = Field(default=2, ge=1, le=10, description="hidden layers of a member")
    support_size: int = Field(default=10_000, ge=100, le=10_000_000)


class EnsembleSection(Section):
    """Everything `train-ensemble` needs."""

    net: EnsembleConfig = EnsembleConfig()
    fit: FitConfig = FitConfig(steps=10_000, batch_size=512)
