"""Configuration of goal-conditioned behaviour cloning on images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.encoder.config import SMALLEST, convolved, doubling
from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.part import MAX_SIZE, FitConfig, Section
from elast_cli.models.tensors import Wanted, floats, network
from elast_cli.shapes import IMAGE_SIZE

if TYPE_CHECKING:
    from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy


class PixelGcbcConfig(GoalNetConfig):
    """Shape of the policy: the convolutions of the conv encoder, then fully connected layers.

    It sees the last `frames` frames of the state, and one of the goal, which is at rest.
    """

    pool: Literal[1, 2, 4] = Field(default=2, description="pixels averaged on each axis, before")
    frames: Literal[1, 3] = 3
    whiten: bool = False
    channels: int = Field(default=16, gt=0, le=256, description="of the first convolution")

    @property
    def side(self) -> int:
        """Side S of a pooled frame."""
        return IMAGE_SIZE // self.pool

    @property
    def images(self) -> int:
        """Frames of state and goal together."""
        return self.frames + 1

    @property
    def conv_channels(self) -> list[int]:
        """Channels of the convolutions, each of which halves the side."""
        return doubling(self.side, self.channels)

    def dense(self, action: int, context: int) -> list[int]:
        """Sizes of the fully connected layers."""
        return self.layers(self.conv_channels[-1] * SMALLEST**2 + context, action)


class ShiftConfig(StrictModel):
    """Random shifts of the training images, the same for the state and its goal."""

    pixels: int = Field(default=2, ge=0, le=16, description="of a pooled image, most on each axis")
    share: float = Field(default=0.5, ge=0, le=1, description="of a batch that is shifted")


class PixelGcbcSection(Section):
    """Everything `train-pixel-gcbc` needs."""

    net: PixelGcbcConfig = PixelGcbcConfig()
    shift: ShiftConfig = ShiftConfig()
    fit: FitConfig = FitConfig(steps=10_000, batch_size=128, learning_rate=3e-4)


class PixelGcbcSpec(StrictModel):
    """What is stored of the policy beside its weights: its shape, and sizes of A and C."""

    net: PixelGcbcConfig
    action: int = Field(gt=0, le=MAX_SIZE)
    context: int = Field(ge=0, le=MAX_SIZE)

    def build(self) -> PixelGoalPolicy:
        """A policy of this shape."""
        from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy

        return PixelGoalPolicy(self.net, self.action, self.context)

    def tensors(self) -> Wanted:
        """Those of the policy."""
        net = self.net
        found = {"mean": floats(3, net.side, net.side), "scale": floats()}
        if net.whiten:
            found["colours"] = floats(3, 3)
        found |= convolved("body", net.images, net.conv_channels)
        return found | network("head", net.dense(self.action, self.context))
