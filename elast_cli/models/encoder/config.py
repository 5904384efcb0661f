"""Configuration of the encoder φ and its objective."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from elast_cli.config import JsonDict, StrictModel
from elast_cli.models.part import MAX_WIDTH, FitConfig, Section, Sizes
from elast_cli.models.tensors import Wanted, floats, network, quantiles, scale
from elast_cli.shapes import IMAGE_SIZE

if TYPE_CHECKING:
    from elast_cli.models.encoder.cpc import Representation


SMALLEST = 4  # side of the innermost feature maps
MOST_CHANNELS = 256
CPC: Literal["cpc"] = "cpc"


def doubling(side: int, channels: int) -> list[int]:
    """Channels of layers that each halve the side, from `side` down to `SMALLEST`."""
    layers = (side // SMALLEST).bit_length() - 1
    return [min(channels * 2**i, MOST_CHANNELS) for i in range(layers)]


def convolved(at: str, frames: int, channels: Sequence[int]) -> Wanted:
    """The tensors of `net.convolutions` of these frames and channels."""
    found: Wanted = {}
    for i, (inner, outer) in enumerate(pairwise([3 * frames, *channels])):
        found[f"{at}.{2 * i}.weight"] = floats(outer, inner, 4, 4)
        found[f"{at}.{2 * i}.bias"] = floats(outer)
    return found


class EncoderConfig(StrictModel):
    """Shape of φ. The sizes are our choice; the paper gives them in its appendix.

    Set `frames` to 1 where nothing has a velocity of its own, so that one frame shows the state.
    With `whiten`, faint hues count as much as brightness.
    """

    architecture: Literal["pooled-mlp", "conv"] = "pooled-mlp"
    latent_size: int = Field(default=8, gt=0, le=256, description="numbers in a latent, d_Z")
    width: int = Field(default=128, gt=0, le=MAX_WIDTH, description="of the dense layers")
    pool: Literal[1, 2, 4, 8] = Field(default=4, description="pixels averaged on each axis, before")
    frames: Literal[1, 3] = Field(default=3, description="frames of a state that φ sees")
    whiten: bool = Field(default=False, description="decorrelate colours")
    channels: int = Field(default=32, gt=0, le=256, description="of the first convolution")

    @property
    def side(self) -> int:
        """Side S of a pooled frame."""
        return IMAGE_SIZE // self.pool

    @property
    def conv_channels(self) -> list[int]:
        """Channels of the convolutions, each of which halves the side, down to `SMALLEST`."""
        return doubling(self.side, self.channels)


class CpcConfig(StrictModel):
    """The objective of Eq. 4; k and K_h are not stated in the paper's main text.

    `negatives` are the last states of the other windows in the batch, or all states of all windows.
    The latter lie few steps from the positive, so they require finer detail.

    With `lookalikes` above 1, a batch consists of groups of windows whose last states lie close
    together in latent space.

    With `isometry_weight`, latent distances follow the distances of blurred images, for pairs of
    states that are close in these images (`models/encoder/isometry.py`).

    With `inverse_weight`, a network reads each action off the states before and after it. So φ
    shows all that actions control, such as a gripper of a few pixels.
    """

    horizon: int = Field(default=3, ge=1, le=20, description="steps predicted, k")
    consistency_weight: float = Field(default=4.0, ge=0, description="K_h")
    dynamics_width: int = Field(default=128, gt=0, le=MAX_WIDTH, description="of h_f")
    still_share: float = Field(default=0.5, ge=0, le=1, description="stacks of one frame")
    negatives: Literal["last", "window"] = "last"
    lookalikes: int = Field(default=1, ge=1, le=1024, description="windows of a group")
    refresh: int = Field(default=250, ge=1, description="steps between two searches for groups")
    isometry_weight: float = Field(default=0.0, ge=0, description="of distances in images")
    isometry_blur: float = Field(default=5.0, gt=0, description="in pixels of a 64x64 frame")
    isometry_reach: float = Field(default=6.0, gt=0, description="in median steps of the images")
    inverse_weight: float = Field(default=0.0, ge=0, description="of reading actions off states")


class VaeConfig(StrictModel):
    """The objective of a β-VAE (Higgins et al. 2017), in place of Eq. 4 for an ablation.

    Its images are those that φ takes, of order one. Their likelihood is a Gaussian of unit
    variance, summed over pixels. Of `cpc` it uses `horizon`, `dynamics_width` and `still_share`.
    """

    beta: float = Field(default=4.0, ge=0, description="weight of the divergence, β")


class EncoderSection(Section):
    """Everything `train-encoder` needs; `vae` matters for the objective `beta-vae` alone."""

    objective: Literal["cpc", "beta-vae"] = Field(default=CPC, description="what trains φ")
    net: EncoderConfig = EncoderConfig()
    cpc: CpcConfig = CpcConfig()
    vae: VaeConfig = VaeConfig()
    fit: FitConfig = FitConfig(steps=8000, batch_size=256)

    @model_validator(mode="after")
    def _resumable(self) -> EncoderSection:
        if self.cpc.lookalikes > 1 and self.fit.save_every % self.cpc.refresh:
            raise ValueError("fit.save_every must be a multiple of cpc.refresh, to be resumable")
        return self

    def determining(self) -> JsonDict:
        """All keys, but none of the β-VAE where φ is trained without it (older recipes agree)."""
        found = super().determining()
        return found if self.objective != CPC else _without(found, "objective", "vae")


def _without(data: JsonDict, *keys: str) -> JsonDict:
    return {key: value for key, value in data.items() if key not in keys}


class EncoderSpec(StrictModel):
    """What is stored of φ and h_f beside its weights."""

    sizes: Sizes
    net: EncoderConfig
    cpc: CpcConfig

    def build(self) -> Representation:
        """φ and h_f of this shape."""
        from elast_cli.models.encoder.cpc import Representation

        return Representation(self.net, self.cpc, self.sizes.action, self.sizes.context)

    def tensors(self) -> Wanted:
        """Those of φ and h_f."""
        sizes, latent, width = self.sizes, self.net.latent_size, self.cpc.dynamics_width
        given = latent + sizes.context
        inverse = network("inverse", [latent + given, width, width, sizes.action])
        return {
            **self._encoder(),
            **network("dynamics.net", [given + sizes.action, width, width, latent]),
            **(inverse if self.cpc.inverse_weight else {}),
            **scale("scale", latent),
            **quantiles("step_length_quantiles"),
        }

    def _encoder(self) -> Wanted:
        net, side = self.net, self.net.side
        found = {"encoder.mean": floats(3, side, side), "encoder.scale": floats()}
        if net.whiten:
            found["encoder.colours"] = floats(3, 3)
        n_in, width = 3 * net.frames, net.width
        if net.architecture == "pooled-mlp":
            layers = [n_in * side * side, width, width, net.latent_size]
            return found | network("encoder.net", layers)
        found |= convolved("encoder.net.body", net.frames, net.conv_channels)
        flat = net.conv_channels[-1] * SMALLEST**2
        return found | network("encoder.net.head", [flat, width, net.latent_size])
