"""Configuration of goal-conditioned implicit Q-learning."""

from __future__ import annotations

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.goal_policy.config import GoalMix, GoalNetConfig, GoalPolicySpec
from elast_cli.models.part import FitConfig, Section


class IqlConfig(StrictModel):
    """The objectives, with the settings of OGBench.

    The reward is -1 in every step until the goal: V is minus the discounted number of steps.

    Random goals for the policy and a small `bc_weight` are what OGBench takes where trajectories
    must be stitched: episodes of random actions are shorter than the way to most goals.
    """

    discount: float = Field(default=0.99, gt=0, lt=1)
    expectile: float = Field(default=0.9, gt=0, lt=1)
    target_rate: float = Field(default=0.005, gt=0, le=1, description="of the targets' average")
    bc_weight: float = Field(default=0.003, ge=0, description="of cloning beside Q (DDPG+BC)")
    value_goals: GoalMix = GoalMix(current=0.2, future=0.5, random=0.3)
    policy_goals: GoalMix = GoalMix(current=0.0, future=0.5, random=0.5)


class GciqlSection(Section):
    """Everything `train-gciql` needs."""

    net: GoalNetConfig = GoalNetConfig()
    critic: GoalNetConfig = GoalNetConfig()
    iql: IqlConfig = IqlConfig()
    fit: FitConfig = FitConfig(steps=20_000, batch_size=256, learning_rate=3e-4)


class GciqlSpec(GoalPolicySpec):
    """What is stored of the policy beside its weights; its critics are not kept."""
