"""Configuration that goal-conditioned policies share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.models.part import MAX_WIDTH, Sizes
from elast_cli.models.tensors import Wanted, network, scale

if TYPE_CHECKING:
    from elast_cli.models.goal_policy.net import GoalPolicy


class GoalNetConfig(StrictModel):
    """Size of a network that takes a state and a goal."""

    width: int = Field(default=512, gt=0, le=MAX_WIDTH)
    depth: int = Field(default=3, ge=1, le=10, description="hidden layers")

    def layers(self, inputs: int, outputs: int) -> list[int]:
        """Sizes of all layers, from the inputs to the outputs."""
        return [inputs, *[self.width] * self.depth, outputs]


class GoalMix(StrictModel):
    """Shares of three kinds of goals; they add up to 1."""

    current: float = Field(ge=0, le=1, description="the state itself")
    future: float = Field(ge=0, le=1, description="a later state of the same episode")
    random: float = Field(ge=0, le=1, description="any state that the data reached")

    @model_validator(mode="after")
    def _whole(self) -> GoalMix:
        if not math.isclose(sum(self.shares), 1, abs_tol=1e-6):
            raise ValueError(f"the shares must add up to 1, not {sum(self.shares):g}")
        return self

    @property
    def shares(self) -> tuple[float, float, float]:
        """Those of current, future and random goals."""
        return self.current, self.future, self.random


class GoalPolicySpec(StrictModel):
    """What is stored of a policy on latents beside its weights."""

    sizes: Sizes
    net: GoalNetConfig

    @property
    def beside(self) -> int:
        """Numbers that the policy is given besides state and goal: the context."""
        return self.sizes.context

    def build(self) -> GoalPolicy:
        """A policy of this shape."""
        from elast_cli.models.goal_policy.net import GoalPolicy

        return GoalPolicy(self.net, self.sizes, self.beside)

    def tensors(self) -> Wanted:
        """Those of the policy."""
        latent, action = self.sizes.latent, self.sizes.action
        layers = self.net.layers(2 * latent + self.beside, action)
        return {**scale("scale", latent), **network("net", layers)}
