"""Configuration of the graph: which training states are kept as a map."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.models.part import PartSection, Sizes
from elast_cli.models.tensors import Want, Wanted, floats

if TYPE_CHECKING:
    from elast_cli.models.graph.net import TrainingStates


class GraphConfig(StrictModel):
    """Number of states that are kept, and the length of their stretches of an episode.

    Long stretches hold more observed transitions, short ones cover more places.
    """

    nodes: int = Field(default=20_000, ge=1, le=10_000_000, description="states kept")
    stretch: int = Field(default=10, ge=1, description="consecutive states that are kept together")


class GraphSection(PartSection):
    """Everything `train-graph` needs. Nothing is fitted."""

    net: GraphConfig = GraphConfig()


class GraphSpec(StrictModel):
    """What is stored of the graph beside its states."""

    sizes: Sizes
    net: GraphConfig

    def build(self) -> TrainingStates:
        """As many states, all zero."""
        from elast_cli.models.graph.net import TrainingStates

        return TrainingStates(self.net.nodes, self.sizes.latent)

    def tensors(self) -> Wanted:
        """Those of the states."""
        nodes = self.net.nodes
        return {"latents": floats(nodes, self.sizes.latent), "rows": Want("int64", (nodes,))}
