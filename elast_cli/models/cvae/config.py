"""Configuration of the conditional variational autoencoder of HTM."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.models.part import FitConfig, Section
from elast_cli.models.tensors import Want, Wanted, floats
from elast_cli.shapes import IMAGE_SIZE

if TYPE_CHECKING:
    from elast_cli.models.cvae.net import Cvae

INNERMOST = 2  # side of the innermost feature maps


class CvaeConfig(StrictModel):
    """Shape of the autoencoder. The authors' code has 32 channels, and 64x64 images."""

    latent_size: int = Field(default=100, gt=0, le=4096, description="numbers in a latent")
    channels: int = Field(default=16, gt=0, le=256, description="of the first convolution")
    pool: Literal[1, 2, 4] = Field(default=1, description="pixels averaged on each axis, before")

    @property
    def side(self) -> int:
        """Side S of a pooled image."""
        return IMAGE_SIZE // self.pool

    @property
    def conv_channels(self) -> list[int]:
        """Channels of the convolutions, which double while each halves the side."""
        layers = (self.side // INNERMOST).bit_length() - 1
        return [self.channels * 2**i for i in range(layers)]

    @property
    def flat(self) -> int:
        """Numbers in the innermost feature maps."""
        return self.conv_channels[-1] * INNERMOST**2


class ElboConfig(StrictModel):
    """The objective: binary cross-entropy of all pixels and a weighted divergence.

    The weight is 0 in the first `free` of all steps and rises from there to `warmup`. With a weight
    from the start, the posterior collapses to the prior before it shows what moves, if that is
    small.
    """

    kl_weight: float = Field(default=10.0, ge=0, le=1e4, description="of the KL divergence")
    free: float = Field(default=0.4, ge=0, le=1, description="share of steps without weight")
    warmup: float = Field(default=0.8, ge=0, le=1, description="share of steps to the full weight")

    @model_validator(mode="after")
    def _in_order(self) -> ElboConfig:
        if self.free > self.warmup:
            raise ValueError(f"warmup must be at least free, {self.free:g}")
        return self

    def weight_at(self, step: int, steps: int) -> float:
        """The weight at a step, from 0 on, of all `steps`."""
        since, rising = step - self.free * steps, (self.warmup - self.free) * steps
        if rising:
            return self.kl_weight * min(max(since / rising, 0.0), 1.0)
        return self.kl_weight * (since >= 0)


class CvaeSection(Section):
    """Everything `train-cvae` needs."""

    net: CvaeConfig = CvaeConfig()
    elbo: ElboConfig = ElboConfig()
    fit: FitConfig = FitConfig(steps=10_000, batch_size=64)


class CvaeSpec(StrictModel):
    """What is stored of the autoencoder beside its weights."""

    net: CvaeConfig
    has_context: bool

    def build(self) -> Cvae:
        """An autoencoder of this shape."""
        from elast_cli.models.cvae.net import Cvae

        return Cvae(self.net, has_context=self.has_context)

    def tensors(self) -> Wanted:
        """Those of the autoencoder."""
        net = self.net
        found = {"steps": Want("int64", ())}
        found |= gaussian("encoder", net, images_seen(has_context=self.has_context))
        if self.has_context:
            found |= gaussian("prior", net, 1)
        found |= {"decoder.0.weight": floats(net.flat, net.latent_size)}
        found |= {"decoder.0.bias": floats(net.flat)}
        widths = [*reversed(net.conv_channels), 3]
        for i, (inner, outer) in enumerate(pairwise(widths)):
            at = f"decoder.{2 + 3 * i}"
            found[f"{at}.weight"] = floats(inner, outer, 4, 4)
            found[f"{at}.bias"] = floats(outer)
            if i:
                found |= normalization(f"decoder.{3 * i}", inner)
        return found


def images_seen(*, has_context: bool) -> int:
    """Images that an encoder sees beside each other: the frame, and its context image."""
    return 2 if has_context else 1


def embedding(at: str, net: CvaeConfig, images: int) -> Wanted:
    """The tensors of an `Embedding`.

    Args:
        at: prefix of their names.
        net: shape of the networks.
        images: seen beside each other as channels.
    """
    widths = [3 * images, *net.conv_channels]
    found = normalization(f"{at}.body.0", widths[0])
    for i, (inner, outer) in enumerate(pairwise(widths)):
        found[f"{at}.body.{3 * i + 1}.weight"] = floats(outer, inner, 4, 4)
        found[f"{at}.body.{3 * i + 1}.bias"] = floats(outer)
        found |= normalization(f"{at}.body.{3 * i + 2}", outer)
    return found | _head(f"{at}.mean", net)


def gaussian(at: str, net: CvaeConfig, images: int) -> Wanted:
    """The tensors of a `GaussianEncoder`.

    Args:
        at: prefix of their names.
        net: shape of the networks.
        images: seen beside each other as channels.
    """
    return embedding(at, net, images) | _head(f"{at}.log_variance", net)


def normalization(at: str, channels: int) -> Wanted:
    """Those of a batch normalisation."""
    names = ("weight", "bias", "running_mean", "running_var")
    found = {f"{at}.{name}": floats(channels) for name in names}
    return found | {f"{at}.num_batches_tracked": Want("int64", ())}


def _head(at: str, net: CvaeConfig) -> Wanted:
    """Those of the last layer of an encoder."""
    size = net.latent_size
    return {f"{at}.weight": floats(size, net.flat), f"{at}.bias": floats(size)}
