"""Configuration of the dynamics ensemble H_f."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_WIDTH, FitConfig, Section, Sizes
from elast_cli.models.tensors import Want, Wanted, floats, network, quantiles, scale

if TYPE_CHECKING:
    from elast_cli.models.ensemble.support import SupportedDynamics


class EnsembleConfig(StrictModel):
    """Size of H_f; m is not stated in the paper's main text."""

    members: int = Field(default=5, ge=1, le=100, description="networks, m")
    width: int = Field(default=128, gt=0, le=MAX_WIDTH, description="of a hidden layer")
    depth: int = Field(default=2, ge=1, le=10, description="hidden layers of a member")
    support_size: int = Field(
        default=10_000, ge=100, le=10_000_000, description="encoded training states kept"
    )


class EnsembleSection(Section):
    """Everything `train-ensemble` needs."""

    net: EnsembleConfig = EnsembleConfig()
    fit: FitConfig = FitConfig(steps=10_000, batch_size=512)


class EnsembleSpec(StrictModel):
    """What is stored of H_f beside its weights."""

    sizes: Sizes
    net: EnsembleConfig

    def build(self) -> SupportedDynamics:
        """An ensemble of this shape, with its support."""
        from elast_cli.models.ensemble.support import SupportedDynamics

        sizes = self.sizes
        return SupportedDynamics(
            self.net,
            latent_size=sizes.latent,
            action_size=sizes.action,
            context_size=sizes.context,
            state_size=sizes.state,
        )

    def tensors(self) -> Wanted:
        """Those of an ensemble with its support."""
        sizes, net = self.sizes, self.net
        widths = [net.width] * net.depth
        n_in = sizes.latent + sizes.action + sizes.context
        return {
            **scale("ensemble.scale", sizes.latent),
            **network("ensemble.layers", [n_in, *widths, sizes.latent], net.members),
            **quantiles("ensemble.variance_quantiles"),
            "support.latents": floats(net.support_size, sizes.latent),
            "support.rows": Want("int64", (net.support_size,)),
            "support.states": floats(net.support_size, sizes.state),
            **quantiles("support.distance_quantiles"),
        }
