"""Configuration of the context autoencoder."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import FitConfig, Section
from elast_cli.models.tensors import Wanted, floats
from elast_cli.shapes import IMAGE_SIZE

if TYPE_CHECKING:
    from elast_cli.models.context.net import ContextAutoencoder


SMALLEST = 4  # side of the innermost feature maps


class ContextConfig(StrictModel):
    """Shape of the autoencoder; the paper says only that it is convolutional."""

    latent_size: int = Field(default=16, gt=0, le=256, description="numbers in a context vector")
    channels: int = Field(default=16, gt=0, le=256, description="of the first layer")
    pool: Literal[1, 2, 4] = Field(default=2, description="pixels averaged on each axis, before")

    @property
    def side(self) -> int:
        """Side S of a pooled image."""
        return IMAGE_SIZE // self.pool


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

    def tensors(self) -> Wanted:
        """Those of the autoencoder."""
        net, side = self.net, self.net.side
        widths = [3, *(net.channels * 2**i for i in range((side // SMALLEST).bit_length() - 1))]
        code, flat, last = net.latent_size, widths[-1] * SMALLEST**2, len(widths) - 1
        found = {"mean": floats(3, side, side), "scale": floats()}
        found |= {"code_mean": floats(code), "code_std": floats(code)}
        for i, (outer, inner) in enumerate(pairwise(widths)):
            down, up = f"down.{2 * i}", f"up.{2 * (last - i) + 1}"
            found[f"{down}.weight"] = found[f"{up}.weight"] = floats(inner, outer, 4, 4)
            found[f"{down}.bias"], found[f"{up}.bias"] = floats(inner), floats(outer)
        found[f"down.{2 * last + 1}.weight"] = floats(code, flat)
        found[f"down.{2 * last + 1}.bias"] = floats(code)
        found |= {"up.0.weight": floats(flat, code), "up.0.bias": floats(flat)}
        return found
