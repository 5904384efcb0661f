"""The interface of a learned part: its section, its training setting, and the result.

Nothing here needs torch at run time, so that presets are validated without it.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import Field

from elast_cli.config import JsonDict, StrictModel
from elast_cli.progress import Progress
from elast_cli.seeding import derived_seed
from elast_cli.shapes import Uint8

if TYPE_CHECKING:
    import torch
    from torch import nn

    from elast_cli.models.tensors import Wanted

IMAGE_SHARE = 0.25  # of the memory that a training may use, for images
MAX_WIDTH = 1 << 16  # sizes are bounded: they come from files
MAX_SIZE = 1 << 20
Precision = Literal["float32", "bfloat16", "auto"]
_STREAMS = {"encoder": 1, "ensemble": 2, "density": 3, "policy": 4, "context": 5, "graph": 6}


class FitConfig(StrictModel):
    """How long and how fast to train.

    With `precision` bfloat16, training computes matrix products and convolutions in bfloat16, and
    rounds the trained weights to it, which halves their files. It is fast for wide networks on
    processors with bfloat16 products, and slow on others. `auto` uses it where it is fast.
    """

    steps: int = Field(gt=0, description="gradient steps")
    batch_size: int = Field(gt=1, le=65_536, description="items of a step")
    learning_rate: float = Field(default=1e-3, gt=0, le=1)
    weight_decay: float = Field(default=0.0, ge=0, le=1)
    precision: Precision = Field(default="float32", description="of matrix products")
    log_every: int = Field(default=100, gt=0, description="steps between two log rows")
    save_every: int = Field(default=500, gt=0, description="steps between two checkpoints")


class PartSection(StrictModel):
    """A part's section of a preset. Parts add their own records, such as `net`."""

    def determining(self) -> JsonDict:
        """The keys that determine the trained part, as plain data for its recipe."""
        return self.model_dump(mode="json")


class Section(PartSection):
    """That of a part which is fitted."""

    fit: FitConfig


class Sizes(StrictModel):
    """Sizes that a model's shape depends on, in addition to its configuration."""

    latent: int = Field(gt=0, le=MAX_SIZE)
    action: int = Field(gt=0, le=MAX_SIZE)
    context: int = Field(ge=0, le=MAX_SIZE)
    state: int = Field(gt=0, le=MAX_SIZE)

    @property
    def has_context(self) -> bool:
        """Whether episodes differ in their context."""
        return self.context > 0


class ModelSpec(Protocol):
    """What is stored beside the weights: all that is needed to build the module again."""

    def build(self) -> nn.Module:
        """A module of the right shape, with any weights."""
        ...


class PlainSpec(ModelSpec, Protocol):
    """That of a part which inference reads without torch."""

    def tensors(self) -> Wanted:
        """The tensors of the module that `build` makes."""
        ...


@dataclass(frozen=True)
class Reconstructions:
    """Images beside what a part that decodes makes of them.

    Attributes:
        images: u8 [N,H,W,3].
        decoded: u8 [N,H',W',3], by what they are.
        labels: one an image.
    """

    images: Uint8
    decoded: Mapping[str, Uint8]
    labels: Sequence[str]


@dataclass(frozen=True)
class Trained:
    """A trained part.

    Attributes:
        module: with its weights and calibration.
        spec: from which it can be built again; a StrictModel.
        curve: one row of metrics every `fit.log_every` steps.
        metrics: of the finished part, for its manifest.
        reconstructions: of a few held-out images, where the part decodes any.
    """

    module: nn.Module
    spec: StrictModel
    curve: list[dict[str, float]]
    metrics: dict[str, float]
    reconstructions: Reconstructions | None = None


@dataclass(frozen=True)
class Setting:
    """Where and how a training runs; the same for every part.

    `memory_gb` bounds what a training on images takes: those that do not fit stay on disk.
    """

    seed: int
    work: Path
    device: torch.device
    progress: Progress
    validation_share: float = 0.1
    memory_gb: float = 4.0


def stream(kind: str) -> int:
    """Number of a part's random stream: no two parts of one seed see the same batches."""
    return _STREAMS.get(kind, zlib.crc32(kind.encode()))


def seed_torch(seed: int, kind: str) -> None:
    """Make the initial weights a function of (seed, kind)."""
    import torch

    torch.manual_seed(derived_seed("train", seed, stream(kind)))
