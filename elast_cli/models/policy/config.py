"""Configuration of the local policy π."""

from __future__ import annotations

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_WIDTH, FitConfig, Section


class PolicyConfig(StrictModel):
    """Size of π."""

    width: int = Field(default=128, gt=0, le=MAX_WIDTH)


class PolicySection(Section):
    """Everything `train-policy` needs."""

    net: PolicyConfig = PolicyConfig()
    fit: FitConfig = FitConfig(steps=6000, batch_size=512)
