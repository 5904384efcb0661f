"""Configuration of the local policy π."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_WIDTH, FitConfig, Section, Sizes
from elast_cli.models.tensors import Wanted, network, quantiles, scale

if TYPE_CHECKING:
    from elast_cli.models.policy.net import LocalPolicy


class PolicyConfig(StrictModel):
    """Size of π."""

    width: int = Field(default=128, gt=0, le=MAX_WIDTH)


class PolicySection(Section):
    """Everything `train-policy` needs."""

    net: PolicyConfig = PolicyConfig()
    fit: FitConfig = FitConfig(steps=6000, batch_size=512)


class PolicySpec(StrictModel):
    """What is stored of π beside its weights."""

    sizes: Sizes
    net: PolicyConfig

    def build(self) -> LocalPolicy:
        """π of this shape."""
        from elast_cli.models.policy.net import LocalPolicy

        sizes = self.sizes
        return LocalPolicy(self.net, sizes.latent, sizes.action, sizes.context)

    def tensors(self) -> Wanted:
        """Those of π."""
        sizes, width = self.sizes, self.net.width
        layers = [2 * sizes.latent + sizes.context, width, width, sizes.action]
        return {
            **scale("scale", sizes.latent),
            **network("net", layers),
            **quantiles("round_trip_quantiles"),
        }
