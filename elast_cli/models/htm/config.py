"""Configuration of the connectivity and the inverse model of HTM."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.cvae.config import CvaeConfig, embedding, images_seen, normalization
from elast_cli.models.part import MAX_SIZE, MAX_WIDTH, FitConfig, Section
from elast_cli.models.tensors import Wanted, floats

if TYPE_CHECKING:
    from elast_cli.models.htm.net import Htm


class HtmConfig(StrictModel):
    """Shape of both networks. Their encoders begin as copies of the one in `cvae`."""

    score_scale: float = Field(default=1000.0, gt=0, description="divides the bilinear score")
    width: int = Field(default=128, gt=0, le=MAX_WIDTH, description="of the first layer")
    depth: int = Field(default=3, ge=1, le=8, description="layers, each twice as wide as before")

    def layers(self, latent: int) -> list[int]:
        """Inputs and hidden layers of the inverse model."""
        return [2 * latent, *(self.width * 2**i for i in range(self.depth))]


class PairConfig(StrictModel):
    """The pairs of images that both networks learn from.

    A positive pair lies 1 to `ahead` steps apart. Its negatives are `negatives` images that the
    autoencoder generates in the same context. Where contexts differ, `per_context` pairs of a
    batch come from one episode and share negatives; elsewhere all pairs do. The score always sees
    reconstructions.
    """

    ahead: int = Field(default=1, ge=1, le=50, description="most steps between two images")
    negatives: int = Field(default=50, ge=1, le=1024, description="generated images for each pair")
    per_context: int = Field(default=16, ge=1, le=4096, description="pairs of one episode")
    inverse_on: Literal["frames", "reconstructions"] = Field(
        default="frames", description="what the inverse model is trained on"
    )


class HtmSection(Section):
    """Everything `train-htm` needs."""

    net: HtmConfig = HtmConfig()
    pairs: PairConfig = PairConfig()
    fit: FitConfig = FitConfig(steps=5000, batch_size=64)


class HtmSpec(StrictModel):
    """What is stored of both networks beside their weights; `cvae` is the shape of its encoder."""

    net: HtmConfig
    cvae: CvaeConfig
    has_context: bool
    action: int = Field(gt=0, le=MAX_SIZE)

    def build(self) -> Htm:
        """Both networks, of this shape."""
        from elast_cli.models.htm.net import Htm

        return Htm(self.net, self.cvae, self.action, has_context=self.has_context)

    def tensors(self) -> Wanted:
        """Those of both networks."""
        seen, latent = images_seen(has_context=self.has_context), self.cvae.latent_size
        found = embedding("score.encoder", self.cvae, seen)
        found["score.bilinear"] = floats(latent, latent)
        found |= embedding("inverse.encoder", self.cvae, seen)
        widths = self.net.layers(latent)
        for i in range(self.net.depth):
            inner, outer = widths[i : i + 2]
            found[f"inverse.head.{3 * i}.weight"] = floats(outer, inner)
            found[f"inverse.head.{3 * i}.bias"] = floats(outer)
            found |= normalization(f"inverse.head.{3 * i + 1}", outer)
        last = f"inverse.head.{3 * self.net.depth}"
        found[f"{last}.weight"] = floats(self.action, widths[-1])
        return found | {f"{last}.bias": floats(self.action)}
