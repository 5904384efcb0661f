"""Configuration of the tree search. The three p are the paper's; what it leaves open is ours.

docs/explanation/method.md has the reasons. Lengths are in median steps, quantiles of observed data.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from elast_cli.config import StrictModel


class SamplingConfig(StrictModel):
    """Which nodes are expanded (Sec. 4.3, biases). p_goal is 1 - p_uniform - p_sparse.

    A node is sparse if few nodes crowd it: those within `crowding_steps`, or all reachable ones.
    With `count_rejections`, the rejected candidates of a node count as crowding, too.
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
    """Expansions of one batch: a `share` of the expansions so far, within bounds.

    One batch deepens a tree by at most one step, so early batches are small.
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
    """Shares of the actions that are tried.

    `edge` is scaled to the edge of the action box. `momentum` continues the node's own direction,
    plus noise. π proposes `steer_goal` towards the goal, and `steer_sparse` towards another sparse
    node.
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

    `density_quantile` sets τ_t, and `variance_quantile` sets τ_e.
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
    """Replanning from the tree of the previous plan.

    Once that tree reaches the goal, a plan spends `expansions`. An old tree keeps at most
    `max_nodes` nodes, or twice the expansions of a first plan. A tree that fills more than half of
    this without reaching the goal is replaced by a new one. Places within `failure_steps` of a
    transition that failed in execution are closed.
    """

    enabled: bool = True
    expansions: int = Field(default=2_000, ge=1)
    failure_steps: float = Field(default=1.2, ge=0)


class RefineConfig(StrictModel):
    """Shooting: changes the actions of `paths` paths so that they end nearer to the goal.

    `iterations` bounds the changes of a path; 0 switches shooting off. A path arrives if it ends
    within `goal_steps` of the goal. The rest of a plan is kept while refinement ends it within
    `kept_steps`.
    """

    iterations: int = Field(default=0, ge=0)
    paths: int = Field(default=6, ge=1)
    goal_steps: float = Field(default=0.6, ge=0)
    kept_steps: float = Field(default=1.25, ge=0)


class TreeConfig(StrictModel):
    """The search.

    `max_nodes` bounds the memory of a tree: a full tree stops. A `time_budget` in seconds stops all
    trees, so the plan depends on the machine. With `prune`, nodes that cannot shorten the path are
    not chosen for being sparse. A tree without other nodes stops. Pruning assumes that no step is
    longer than `Radii.longest`, which for trained models is 1.05 times the longest observed one.
    A path reaches the goal if it ends within `goal_steps` of it. A new node is dropped if a node
    that costs no more lies within `duplicate_steps`.
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
