"""Configuration of inverse dynamics over several steps."""

from __future__ import annotations

from pydantic import Field

from elast_cli.models.goal_policy.config import GoalNetConfig, GoalPolicySpec
from elast_cli.models.part import FitConfig, Section


class GcidmConfig(GoalNetConfig):
    """Size of the network, and how far goals may be."""

    longest: int = Field(default=50, ge=1, le=100_000, description="most steps to a goal")


class GcidmSection(Section):
    """Everything `train-gcidm` needs."""

    net: GcidmConfig = GcidmConfig()
    fit: FitConfig = FitConfig(steps=20_000, batch_size=256, learning_rate=3e-4)


class GcidmSpec(GoalPolicySpec):
    """What is stored of the model beside its weights."""

    net: GcidmConfig

    @property
    def beside(self) -> int:
        """Numbers besides state and goal: 1/h and the context."""
        return 1 + self.sizes.context
