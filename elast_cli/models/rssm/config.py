"""Configuration of PlaNet's recurrent state-space model (Hafner et al. 2019)."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_SIZE, MAX_WIDTH, FitConfig, Section
from elast_cli.models.tensors import Wanted, floats, network, quantiles
from elast_cli.shapes import IMAGE_SIZE

if TYPE_CHECKING:
    from elast_cli.models.rssm.net import Rssm

ENCODING = 4  # side of the kernels of the encoder, whose feature maps end at 2 x 2
DECODING = (5, 5, 6, 6)  # sides of the kernels of the decoder, from 1 x 1 to 64 x 64


class RssmConfig(StrictModel):
    """Shape of the model. Sizes are PlaNet's, except `channels`: PlaNet has 32."""

    stochastic: int = Field(default=30, gt=0, le=MAX_WIDTH, description="size of s")
    belief: int = Field(default=200, gt=0, le=MAX_WIDTH, description="size of h, units of the GRU")
    hidden: int = Field(default=200, gt=0, le=MAX_WIDTH, description="of fully connected layers")
    min_std: float = Field(default=0.1, gt=0, description="least deviation of s")
    channels: int = Field(
        default=16, gt=0, le=256, description="of the first convolution; doubled by the next ones"
    )

    @property
    def side(self) -> int:
        """Side S of a frame."""
        return IMAGE_SIZE

    @property
    def image_bytes(self) -> int:
        """Of a frame as training holds it: one a pixel and colour."""
        return 3 * self.side**2

    @property
    def down(self) -> list[int]:
        """Channels through the encoder."""
        return [3, *(self.channels * 2**i for i in range(4))]

    @property
    def up(self) -> list[int]:
        """Channels through the decoder."""
        return [self.embedded, *(self.channels * 2**i for i in (2, 1, 0)), 3]

    @property
    def embedded(self) -> int:
        """Numbers that the encoder makes of a frame."""
        return 4 * self.down[-1]


class ElboConfig(StrictModel):
    """The objective: the evidence lower bound on sequences, in nats a frame.

    Episodes that are shorter than `length` are taken whole.
    """

    length: int = Field(default=20, ge=2, le=10_000, description="frames of a sequence; PlaNet: 50")
    free_nats: float = Field(
        default=3.0, ge=0, description="a smaller divergence of a frame costs as much"
    )
    kl_scale: float = Field(default=1.0, ge=0, description="weight of the divergence")


class RssmSection(Section):
    """Everything `train-rssm` needs. An item of a batch is a sequence."""

    net: RssmConfig = RssmConfig()
    elbo: ElboConfig = ElboConfig()
    fit: FitConfig = FitConfig(steps=10_000, batch_size=16)

    @property
    def item_images(self) -> int:
        """Frames of an item of a batch."""
        return self.elbo.length


class RssmSpec(StrictModel):
    """What is stored of the model beside its weights: its shape, and the size of A."""

    net: RssmConfig
    action: int = Field(gt=0, le=MAX_SIZE)

    def build(self) -> Rssm:
        """A model of this shape."""
        from elast_cli.models.rssm.net import Rssm

        return Rssm(self.net, self.action)

    def tensors(self) -> Wanted:
        """Those of the model."""
        net = self.net
        found: Wanted = {}
        for i, (outer, inner) in enumerate(pairwise(net.down)):
            found[f"encoder.{2 * i}.weight"] = floats(inner, outer, ENCODING, ENCODING)
            found[f"encoder.{2 * i}.bias"] = floats(inner)
        features = net.stochastic + net.belief
        found["decoder.0.weight"] = floats(net.embedded, features)
        found["decoder.0.bias"] = floats(net.embedded)
        for i, (side, (inner, outer)) in enumerate(zip(DECODING, pairwise(net.up), strict=True)):
            found[f"decoder.{2 * i + 2}.weight"] = floats(inner, outer, side, side)
            found[f"decoder.{2 * i + 2}.bias"] = floats(outer)
        found["enter.weight"] = floats(net.hidden, net.stochastic + self.action)
        found["enter.bias"] = floats(net.hidden)
        for name, inner in (("ih", net.hidden), ("hh", net.belief)):
            found[f"cell.weight_{name}"] = floats(3 * net.belief, inner)
        found |= {f"cell.bias_{name}": floats(3 * net.belief) for name in ("ih", "hh")}
        ends = [net.hidden, 2 * net.stochastic]
        found |= network("to_prior", [net.belief, *ends])
        found |= network("to_posterior", [net.belief + net.embedded, *ends])
        return found | quantiles("step_length_quantiles")
