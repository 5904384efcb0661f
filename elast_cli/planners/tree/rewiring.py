"""Insertion and rewiring: cheaper parents for new nodes and their neighbours (Fig. 4 c to f)."""

from __future__ import annotations

import numpy as np

from elast_cli.planners import neighbors
from elast_cli.planners.tree import selection, siblings
from elast_cli.planners.tree.edges import edges_around, ends, pick
from elast_cli.planners.tree.forest import insert, rewire
from elast_cli.planners.tree.growth import Batch, Growth
from elast_cli.shapes import Bool, Float32, Int32

ROOM = 1 << 14  # pairs, at first


class Rewiring:
    """Adds candidates to the trees and rewires around them; keeps the memory for pairs."""

    def __init__(self, growth: Growth) -> None:
        self.growth = growth
        self._pairs: Int32 = np.empty((3, ROOM), np.int32)
        self._gaps: Float32 = np.empty(ROOM, np.float32)

    def insert(self, batch: Batch) -> None:
        """Add the candidates that passed, count whom they crowd, and rewire around them."""
        growth, forest, config = self.growth, self.growth.forest, self.growth.config
        pairs, gaps = self._neighbors(batch)
        before = forest.size.copy()
        new = insert(forest, batch.rows, batch.latent, batch.alive, batch.parent, batch.action)
        growth.admit(before)
        edges, gap = edges_around(pairs, gaps, new, forest.capacity)
        likely: Bool | None = None
        counted = edges, gap
        if config.sampling.crowding == "reachable" and growth.transitions.asks_density:
            likely = growth.transitions.likely(forest, *edges)
            counted = edges[:, likely], gap[likely]
        selection.crowd_along(growth.sparsity, *counted, growth.radii.crowding**2)
        if config.sampling.count_rejections:
            selection.crowd_rejected(growth.sparsity, batch.rows, batch.alive, batch.parent)
        if config.rewire.enabled:
            self._offer(edges, gap, likely)
        if config.prune:
            goal, longest = growth.radii.goal, growth.radii.longest
            selection.prune(growth.sparsity, forest, batch.rows, goal, longest)

    def _neighbors(self, batch: Batch) -> tuple[Int32, Float32]:
        """Pairs (row, k, node) [3,P] within r_neigh of live candidates, and their squared gaps.

        Pairs with nodes of the trees come first, then those of siblings: sibling j is node N + j.
        """
        growth, rows = self.growth, batch.rows
        radius, capacity = growth.radii.neighbor, growth.forest.capacity
        while True:
            pairs, gaps = self._pairs, self._gaps
            found = neighbors.find_pairs(
                growth.cells, rows, batch.latent, batch.alive, radius, pairs, gaps
            )
            found = siblings.add_pairs(
                rows, batch.latent, batch.alive, radius, capacity, pairs, gaps, found
            )
            if found <= len(gaps):
                return pairs[:, :found], gaps[:found]
            self._pairs = np.empty((3, 2 * found), np.int32)
            self._gaps = np.empty(2 * found, np.float32)

    def _offer(self, edges: Int32, gap: Float32, likely: Bool | None) -> None:
        """Rewire targets to the cheapest sources that pass the tests, trying the cheapest first.

        New nodes settle on a parent first; from the second round on they are offered as parents.

        Args:
            edges: (row, source, target) [3,2P]: P into new nodes, then the same reversed.
            gap: their squared lengths [2P].
            likely: what ψ says of them [2P], if it has been asked.
        """
        forest, transitions, half = self.growth.forest, self.growth.transitions, len(gap) // 2
        untried = np.ones(2 * half, np.bool_) if likely is None else likely
        ask = likely is None and transitions.asks_density
        reverse, untried[half:] = untried[half:].copy(), False
        for attempt in range(1 + self.growth.config.rewire.candidates):
            if attempt == 1:
                untried[half:] = reverse
            row, source, target = pick(forest, edges, gap, untried)
            if attempt and not len(row):
                return
            if ask and len(row):
                passed = transitions.likely(forest, row, source, target)
                row, source, target = row[passed], source[passed], target[passed]
            if len(row):
                action, admissible = transitions.round_trip(*ends(forest, row, source, target))
                rewire(forest, row, source, target, action, admissible)
