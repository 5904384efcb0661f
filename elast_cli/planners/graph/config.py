"""Configuration of the search on a graph."""

from __future__ import annotations

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.planners.tree.config import TestsConfig


class GraphSearchConfig(StrictModel):
    """The map and the search. Lengths are in median steps, quantiles of observed data.

    States nearer than `spacing_steps` to a node are merged into it; nodes within the
    `neighbor_quantile` of observed steps are joined. The support test is not needed, since nodes
    are encoded states. After `edge_tests` of one plan untested edges count as rejected. Places
    within `failure_steps` of a transition that execution tried in vain are closed.
    """

    spacing_steps: float = Field(default=0.25, ge=0)
    neighbor_quantile: float = Field(default=0.95, gt=0, le=1)
    goal_steps: float = Field(default=1.0, gt=0)
    failure_steps: float = Field(default=1.2, ge=0)
    edge_tests: int = Field(default=200_000, ge=1)
    tests: TestsConfig = TestsConfig()
