"""Configuration of the tree search. The three p are the paper's; what it leaves open is ours.

docs/explanation/method.md has the reasons. Lengths are in median steps, quantiles of observed data.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from elast_cli.config import StrictModel


class SamplingConfig(StrictModel):
    """Which nodes are expanded (Sec. 4.3, biases). p_goal is what the other two leave of 1.

    A node is sparse that few others crowd: those within `crowding_steps`, or all reachable ones.
    With `count_rejections`, candidates that were rejected crowd the node that they came from.
    """

    p_uniform: float = Field(default=0.2, ge=0, le=1)
    p_sparse: float = Field(default=0.78, ge=0, le=1)
    sparse_exponent: float = Field(default=3.0, ge=0)
    crowding: Literal["near", "reachable"] = "near"
    crowding_steps: float | None = Field(default=0.5, gt=0)
    count_rejections: bool = True

    @model_validator(mode="after")
    def _shares(self) -> SamplingConfig:
        if self.p_uniform + self.p_sparse > 1 + 1e-9:
            raise ValueError("p_uniform + p_sparse must not exceed 1; the rest is p_goal")
        return self


class BatchConfig(StrictModel):
    """Expansions at a time: a `share` of those done so far, within bounds.

    A tree deepens by at most one step a batch, so batches begin small.
    """

    min: int = Field(default=16, ge=1)
    max: int = Field(default=128, ge=1)
    share: float = Field(default=1 / 16, ge=0, le=1)

    @model_validator(mode="after")
    def _bounds(self) -> BatchConfig:
        if self.min > self.max:
            raise ValueError("min must not exceed max")
        return self


class ActionsConfig(StrictModel):
    """Which actions are tried: shares of all of them.

    `edge` is scaled to the edge of the box; `momentum` keeps the node's own direction, plus noise.
    π proposes `steer_goal` towards the goal and `steer_sparse` towards another sparse node.
    """

    edge: float = Field(default=0.5, ge=0, le=1)
    momentum: float = Field(default=0.5, ge=0, le=1)
    momentum_noise: float = Field(default=0.3, ge=0)
    steer_goal: float = Field(default=0.0, ge=0, le=1)
    steer_sparse: float = Field(default=0.0, ge=0, le=1)

    @model_validator(mode="after")
    def _shares(self) -> ActionsConfig:
        if self.steer_goal + self.steer_sparse > 1 + 1e-9:
            raise ValueError("steer_goal + steer_sparse must not exceed 1")
        return self


class TestsConfig(StrictModel):
    """Thresholds of a transition as quantiles on held-out transitions; null switches a test off.

    `density_quantile` is that of τ_t, `variance_quantile` that of τ_e.
    """

    density_quantile: float | None = Field(default=0.02, ge=0, lt=1)
    variance_quantile: float | None = Field(default=0.99, gt=0, le=1)
    support_quantile: float | None = Field(default=0.99, gt=0, le=1)
    round_trip_quantile: float | None = Field(default=0.95, gt=0, le=1)


class RewireConfig(StrictModel):
    """Rewiring within r_neigh, a quantile of step lengths, with at most `candidates` parents."""

    enabled: bool = True
    neighbor_quantile: float = Field(default=0.95, gt=0, le=1)
    candidates: int = Field(default=3, ge=1)


class ReuseConfig(StrictModel):
    """Replanning from the tree of the plan before.

    Once that tree reaches the goal, a plan spends `expansions`. Of an old tree no more than
    `max_nodes`, or twice the expansions of a first plan, is kept. One that does not reach the goal
    and leaves less than half of this free gives way to a new one. Places within `failure_steps` of
    a transition that execution tried in vain are closed.
    """

    enabled: bool = True
    expansions: int = Field(default=2_000, ge=1)
    failure_steps: float = Field(default=1.2, ge=0)


class RefineConfig(StrictModel):
    """Shooting: the actions of `paths` paths are changed so that they end nearer to the goal.

    At most `iterations` times; 0 leaves paths as the tree has them. A path ought to end within
    `goal_steps` of the goal. What is left of a plan is kept while it can be refined to end within
    `kept_steps`.
    """

    iterations: int = Field(default=0, ge=0)
    paths: int = Field(default=6, ge=1)
    goal_steps: float = Field(default=0.6, ge=0)
    kept_steps: float = Field(default=1.25, ge=0)


class TreeConfig(StrictModel):
    """The search.

    `max_nodes` bounds a tree's memory: a full tree stops. A `time_budget` in seconds stops all
    trees; which plan it leaves depends on the machine. With `prune`, nodes that cannot shorten the
    path any more are not chosen for being sparse, and a tree without any others stops. That takes
    no step to be longer than `Radii.longest`, which for trained models is a little more than any
    observed one. A path reaches the goal that ends within `goal_steps` of it. A new node nearer
    than `duplicate_steps` to one that is no costlier is dropped.
    """

    expansions: int = Field(default=12_000, ge=1)
    max_nodes: int | None = Field(default=None, ge=1)
    time_budget: float | None = Field(default=None, gt=0)
    goal_steps: float = Field(default=1.0, gt=0)
    duplicate_steps: float = Field(default=0.2, ge=0)
    prune: bool = True
    use_ensemble: bool = True
    sampling: SamplingConfig = SamplingConfig()
    batch: BatchConfig = BatchConfig()
    actions: ActionsConfig = ActionsConfig()
    tests: TestsConfig = TestsConfig()
    rewire: RewireConfig = RewireConfig()
    reuse: ReuseConfig = ReuseConfig()
    refine: RefineConfig = RefineConfig()
