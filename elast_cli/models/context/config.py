"""Configuration of the context autoencoder."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import FitConfig, Section

if TYPE_CHECKING:
    from elast_cli.models.context.net import ContextAutoencoder


class ContextConfig(StrictModel):
    """Shape of the autoencoder; the paper says only that it is convolutional."""

    latent_size: int = Field(default=16, gt=0, le=256, description="numbers in a context vector")
    channels: int = Field(default=16, gt=0, le=256, description="of the first layer")
    pool: Literal[1, 2, 4] = Field(default=2, description="pixels averaged on each axis, before")


class ContextSection(Section):
    """Everything `train-context` needs."""

    net: ContextConfig = ContextConfig()
    fit: FitConfig = FitConfig(steps=2000, batch_size=128)


class ContextSpec(StrictModel):
    """What is stored of a context autoencoder beside its weights."""

    net: ContextConfig

    def build(self) -> ContextAutoencoder:
        """An autoencoder of this shape."""
        from elast_cli.models.context.net import ContextAutoencoder

        return ContextAutoencoder(self.net)
