"""Configuration of the transition density ψ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import AliasChoices, Field

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_WIDTH, FitConfig, Section, Sizes
from elast_cli.models.tensors import Wanted, floats, network, quantiles, scale

if TYPE_CHECKING:
    from elast_cli.models.density.net import TransitionDensity


class DensityConfig(StrictModel):
    """Shape of ψ and its noise; neither ν nor Σ is stated in the paper's main text.

    Where episodes differ in their context, part of the noise fits other contexts, and part of the
    data comes from other episodes that fit the context. Of the rest of the noise, a share leads to
    latents of the data near the source. Without both, it is the paper's Gaussian noise.
    """

    width: int = Field(default=128, gt=0, le=MAX_WIDTH, description="of a hidden layer")
    depth: int = Field(default=2, ge=1, le=10, description="hidden layers")
    noise_ratio: int = Field(default=10, ge=1, description="false transitions for a true one, ν")
    noise_scale: float = Field(default=1.0, gt=0, description="factor on Σ")
    near_share: float = Field(default=0.8, ge=0, le=1, description="of noise: latents near by")
    near_radius: float = Field(default=1.25, gt=0, description="in 95 % quantiles of step lengths")
    context_share: float = Field(default=0.5, ge=0, le=1, description="of noise: other contexts")
    relabelled_share: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="of data: other episodes, at most",
        validation_alias=AliasChoices("relabelled_share", "lent_share"),  # as models of 0.1 say
    )

    def elsewhere(self, context_size: int) -> int:
        """How many of the ν false transitions fit other contexts, of `context_size` numbers."""
        return round(self.context_share * self.noise_ratio) if context_size else 0

    def near(self, context_size: int) -> int:
        """How many of the ν false transitions lead to latents of the data near by."""
        return round(self.near_share * (self.noise_ratio - self.elsewhere(context_size)))

    def relative(self, context_size: int) -> bool:
        """Whether the noise has no known density, since part of it is data."""
        return self.near(context_size) + self.elsewhere(context_size) > 0


class DensitySection(Section):
    """Everything `train-density` needs."""

    net: DensityConfig = DensityConfig()
    fit: FitConfig = FitConfig(steps=5000, batch_size=512)


class DensitySpec(StrictModel):
    """What is stored of ψ beside its weights."""

    sizes: Sizes
    net: DensityConfig

    def build(self) -> TransitionDensity:
        """ψ of this shape."""
        from elast_cli.models.density.net import TransitionDensity

        return TransitionDensity(self.net, self.sizes.latent, self.sizes.context)

    def tensors(self) -> Wanted:
        """Those of ψ."""
        sizes, width = self.sizes, self.net.width
        return {
            **scale("scale", sizes.latent),
            "first.weight": floats(width, 2 * sizes.latent + sizes.context),
            "first.bias": floats(width),
            **network("rest.1", [width] * self.net.depth + [1]),
            **quantiles("log_density_quantiles"),
        }
