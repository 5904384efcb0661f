"""ELAST: grow and rewire trees through latent space towards a goal (Sec. 4.3, Fig. 4)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elast_cli.planners import grid
from elast_cli.planners.base import Limits, Plan, PlanCost, Query, Radii, WorldOf
from elast_cli.planners.tree import reuse, selection
from elast_cli.planners.tree.actions import DIRECTION
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.expansion import expanded
from elast_cli.planners.tree.forest import Forest, path_to, plant
from elast_cli.planners.tree.growth import Growth
from elast_cli.planners.tree.replanting import budget, replanted
from elast_cli.planners.tree.reuse import Memory
from elast_cli.planners.tree.rewiring import Rewiring
from elast_cli.planners.tree.selection import Sparsity
from elast_cli.planners.tree.transitions import Transitions
from elast_cli.shapes import Bool, Int64

CELLS_PER_RADIUS = 2  # of r_neigh, in the neighbour search
NEW_GROUND = 0.01  # share of the later nodes beyond r_neigh that a tree without a frontier has
ROOT_EXPANSIONS = 1000  # after which a tree that has not left its root stops


@dataclass(frozen=True)
class ElastPlanner:
    """Plans by trees; row i of a batch equals a solo run of row i."""

    world: WorldOf
    config: TreeConfig
    limits: Limits
    radii: Radii

    def plan(self, query: Query) -> Plan:
        """Grow a tree for each row and return its best path."""
        return self.grow(query).best_plan()

    def grow(self, query: Query) -> Search:
        """Grow a tree for each row."""
        search = Search(self, query)
        search.run()
        return search


class Search:
    """One batch of trees: planted, grown within a budget, and asked for their best paths.

    Attributes:
        query: the problems.
        growth: the trees, and all that a step of growth works on.
        cost: network calls so far.
        budget: expansions of each row [B].
        done: expansions so far, of every row.
    """

    def __init__(self, planner: ElastPlanner, query: Query) -> None:
        self.began = time.monotonic()
        self.config, self.query = planner.config, query
        config, scenarios = planner.config, len(query.start)
        world = planner.world(query.context)
        self.cost = PlanCost.zero(scenarios)
        self._draws = selection.Draws(query.seed, DIRECTION + world.action_size)
        failed = {b: pairs for b, pairs in enumerate(query.failed) if len(pairs)}
        transitions = Transitions(world, planner.limits, failed, planner.radii.failure, self.cost)
        roots = world.features(query.start, np.arange(scenarios))
        old = [
            replanted(
                query, b, roots[b], config=config, radii=planner.radii, transitions=transitions
            )
            for b in range(scenarios)
        ]
        self.budget = np.array(
            [budget(config, planner.radii, tree, query.goal[b]) for b, tree in enumerate(old)]
        )
        self._replans = np.array(
            [config.reuse.enabled and m is not None for m in query.memory or [None] * scenarios]
        )
        self.growth = self._planted(planner, transitions, old)
        self._rewiring = Rewiring(self.growth)
        self.done = 0

    @property
    def forest(self) -> Forest:
        """The trees."""
        return self.growth.forest

    def _planted(
        self, planner: ElastPlanner, transitions: Transitions, old: Sequence[Memory]
    ) -> Growth:
        """The old trees with room to grow."""
        config, query, scenarios = self.config, self.query, len(old)
        needed = max(len(tree.depth) + n for tree, n in zip(old, self.budget, strict=True))
        nodes = min(config.max_nodes or needed, needed)
        forest = plant(
            query.start,
            np.stack([tree.feature[0] for tree in old]),
            query.goal,
            nodes=nodes,
            extra=config.batch.max,
            actions=transitions.world.action_size,
        )
        for b, tree in enumerate(old):
            reuse.restore(forest, b, tree)
        side = planner.radii.neighbor / CELLS_PER_RADIUS
        cells = grid.empty_cells(scenarios, nodes, axes=transitions.world.axes, side=side)
        sparsity = Sparsity(
            selection.no_weights(scenarios, nodes),
            forest.crowding,
            selection.weight_table(config.sampling.sparse_exponent),
        )
        growth = Growth(config, planner.radii, transitions, forest, cells, sparsity)
        growth.admit(np.zeros(scenarios, np.int64))
        return growth

    def run(self) -> None:
        """Spend the budget of expansions, or of time since the search began."""
        seconds = self.config.time_budget or np.inf
        forest, sums = self.forest, self.growth.sparsity.sums
        while time.monotonic() - self.began < seconds:
            open_ended = (forest.size < forest.capacity) & (sums[:, 1] > 0)
            open_ended &= (forest.size > 1) | (self.done < ROOT_EXPANSIONS)
            rows = np.flatnonzero(open_ended & (self.done < self.budget))
            if not len(rows):
                break
            self.expand(rows)
            arrived = self._replans & (forest.nearest_distance <= self.growth.radii.goal)
            enough = self.done + self.config.reuse.expansions
            self.budget[arrived] = np.minimum(self.budget[arrived], enough)

    def expand(self, rows: Int64) -> None:
        """One batch in the trees of `rows` [R]: select, step, test, insert, rewire.

        The batch grows with the number of expansions done, since a tree can deepen by no more
        than one step a batch: small batches first, to get deep, then large ones, to be fast.
        """
        config, batch = self.config, self.config.batch
        size = int(np.clip(self.done * batch.share, batch.min, batch.max))
        for stop in (config.reuse.expansions, config.expansions):  # of any row, so of every row
            size = min(size, stop - self.done) if self.done < stop else size
        draws = self._draws.take(size)[rows]
        self.done += size
        self._rewiring.insert(expanded(self.growth, rows, draws))

    def best_nodes(self) -> tuple[Int64, Bool]:
        """The end of each row's path [B], and whether it lies within r_goal of the goal [B].

        The cheapest node within r_goal, the nearer of two; else the node nearest to the goal.
        """
        forest, goal, radius = self.forest, self.query.goal, self.growth.radii.goal
        nodes = forest.nearest.copy()
        for b in np.flatnonzero(forest.nearest_distance <= radius):
            latent = forest.latent[b, : forest.size[b]]
            distance = np.linalg.norm(latent - goal[b], axis=1)
            inside = np.flatnonzero(distance <= radius)
            if len(inside):
                order = np.lexsort((distance[inside], forest.depth[b, inside]))
                nodes[b] = inside[order[0]]
        return nodes, forest.nearest_distance <= radius

    def best_plan(self) -> Plan:
        """Backtrack from each row's best node."""
        nodes, reached = self.best_nodes()
        forest = self.forest
        paths = [path_to(forest, b, int(node)) for b, node in enumerate(nodes)]
        longest = max(map(len, paths))
        index = np.array([path + [path[-1]] * (longest - len(path)) for path in paths])
        rows = np.arange(len(paths))[:, None]
        kept = self.config.reuse.enabled
        return Plan(
            states=forest.latent[rows, index],
            actions=forest.action[rows, index[:, 1:]],
            length=np.array([len(path) for path in paths]),
            reached=reached,
            cost=self.cost,
            memory=[reuse.remember(forest, b) for b in rows[:, 0]] if kept else (),
            blocked=[b for b in self.growth.transitions.failed if not reached[b]],
            nodes=forest.size.tolist(),
            exhausted=lambda: self.exhausted().tolist(),
        )

    def exhausted(self) -> Bool:
        """Whether each tree has covered all that it can reach, without the goal [B].

        The last quarter of its nodes then lies within r_neigh of the others, but for a few. A tree
        that has not left its root has covered it, too. Fewer expansions than `ROOT_EXPANSIONS`
        do not tell.
        """
        from scipy.spatial import cKDTree  # slow to import, and rarely used

        forest, radius = self.forest, self.growth.radii.neighbor
        covered = forest.nearest_distance > self.growth.radii.goal
        covered &= self.done >= ROOT_EXPANSIONS
        for b in np.flatnonzero(covered):
            latent = forest.latent[b, : forest.size[b]]
            early = len(latent) - len(latent) // 4
            gap, _ = cKDTree(latent[:early]).query(latent[early:])
            covered[b] = (gap > radius).sum() <= NEW_GROUND * len(gap)
        return covered
