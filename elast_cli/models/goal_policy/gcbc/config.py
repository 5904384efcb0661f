"""Configuration of goal-conditioned behaviour cloning on latents."""

from __future__ import annotations

from elast_cli.models.goal_policy.config import GoalNetConfig, GoalPolicySpec
from elast_cli.models.part import FitConfig, Section


class GcbcSection(Section):
    """Everything `train-gcbc` needs."""

    net: GoalNetConfig = GoalNetConfig()
    fit: FitConfig = FitConfig(steps=20_000, batch_size=256, learning_rate=3e-4)


class GcbcSpec(GoalPolicySpec):
    """What is stored of the policy beside its weights."""
