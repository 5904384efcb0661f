"""Configuration of the search on a graph."""

from __future__ import annotations

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.planners.tree.config import TestsConfig


class GraphSearchConfig(StrictModel):
    """The map and the search. Lengths are in median steps, quantiles of observed data.

    States within `spacing_steps` of a node are merged into it. Nodes within the `neighbor_quantile`
    of observed steps are joined. Nodes are encoded states, so there is no support test. Once a plan
    has tested `edge_tests` edges, all untested edges count as rejected. Places within
    `failure_steps` of a transition that failed in execution are closed.
    """

    spacing_steps: float = Field(default=0.25, ge=0, description="nearer states are merged")
    neighbor_quantile: float = Field(default=0.95, gt=0, le=1, description="r_neigh")
    goal_steps: float = Field(default=1.0, gt=0, description="a path this near has arrived")
    failure_steps: float = Field(default=1.2, ge=0, description="radius of closed places")
    edge_tests: int = Field(default=200_000, ge=1, description="most of one plan")
    tests: TestsConfig = TestsConfig()
