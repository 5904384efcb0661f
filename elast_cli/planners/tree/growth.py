"""One batch of trees while it grows: what every step of a search reads and writes."""

from __future__ import annotations

from dataclasses import dataclass

from elast_cli.planners import grid
from elast_cli.planners.base import Radii
from elast_cli.planners.grid import Cells
from elast_cli.planners.tree import selection
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.forest import Forest
from elast_cli.planners.tree.selection import Sparsity
from elast_cli.planners.tree.transitions import Transitions
from elast_cli.shapes import Bool, Float32, Int32, Int64


@dataclass(frozen=True)
class Growth:
    """Trees of B scenarios.

    Attributes:
        config: of the search.
        radii: in latent units.
        transitions: predicts and tests.
        forest: the trees.
        cells: their nodes, to find neighbours.
        sparsity: how likely nodes are to be expanded for being sparse.
    """

    config: TreeConfig
    radii: Radii
    transitions: Transitions
    forest: Forest
    cells: Cells
    sparsity: Sparsity

    def admit(self, before: Int64) -> None:
        """Let the nodes added since sizes were `before` [B] be found and drawn."""
        grid.add(self.cells, self.forest.latent, before, self.forest.size)
        selection.admit(self.sparsity, before, self.forest.size)


@dataclass(frozen=True)
class Batch:
    """Candidates of one expansion in the trees `rows` [R].

    Attributes:
        rows: [R].
        parent: node each comes from [R,K].
        action: [R,K,A].
        latent: where it leads [R,K,Z].
        alive: whether it has passed all tests so far [R,K].
    """

    rows: Int64
    parent: Int32
    action: Float32
    latent: Float32
    alive: Bool
