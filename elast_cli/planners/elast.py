"""ELAST: grow and rewire trees through latent space towards a goal (Sec. 4.3, Fig. 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.planners import tree
from elast_cli.planners.base import Limits, Plan, Query, Radii, WorldOf
from elast_cli.planners.tree import Forest
from elast_cli.seeding import generator
from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64


class TreeConfig(StrictModel):
    """The search. The three p are the paper's; what it does not state is ours: docs/method.md."""

    expansions: int = Field(default=12_000, ge=1)
    batch_min: int = Field(default=8, ge=1)
    batch_max: int = Field(default=32, ge=1)
    batch_share: float = Field(default=1 / 64, ge=0, le=1)
    p_uniform: float = Field(default=0.2, ge=0, le=1)
    p_sparse: float = Field(default=0.78, ge=0, le=1)
    sparse_exponent: float = Field(default=3.0, ge=0)
    crowding: Literal["near", "reachable"] = "near"
    count_rejections: bool = True
    edge_actions: float = Field(default=0.5, ge=0, le=1)
    momentum: float = Field(default=0.5, ge=0, le=1)
    momentum_noise: float = Field(default=0.3, ge=0)
    rewire: bool = True
    connect_candidates: int = Field(default=3, ge=1)
    use_ensemble: bool = True
    density_quantile: float | None = Field(default=0.005, ge=0, lt=1)
    variance_quantile: float | None = Field(default=0.99, gt=0, le=1)
    support_quantile: float | None = Field(default=0.99, gt=0, le=1)
    round_trip_quantile: float | None = Field(default=0.99, gt=0, le=1)
    neighbor_quantile: float = Field(default=0.95, gt=0, le=1)
    crowding_steps: float | None = Field(default=0.5, gt=0)
    goal_steps: float = Field(default=1.0, gt=0)
    duplicate_steps: float = Field(default=0.2, ge=0)

    @model_validator(mode="after")
    def _shares_and_batches(self) -> TreeConfig:
        if self.p_uniform + self.p_sparse > 1 + 1e-9:
            raise ValueError("p_uniform + p_sparse must not exceed 1; the rest is p_goal")
        if self.batch_min > self.batch_max:
            raise ValueError("batch_min must not exceed batch_max")
        return self


@dataclass
class Tally:
    """Network calls of each scenario so far [B]."""

    transitions: Int64
    density: Int64
    policy: Int64

    @classmethod
    def zero(cls, scenarios: int) -> Tally:
        """No calls yet."""
        return cls(*(np.zeros(scenarios, np.int64) for _ in range(3)))


@dataclass(frozen=True)
class ElastPlanner:
    """Plans by trees; row i of a batch equals a solo run of row i."""

    world: WorldOf
    config: TreeConfig
    limits: Limits
    radii: Radii

    def plan(self, query: Query) -> Plan:
        """Grow a tree for each row and return its best path."""
        search = Search(self, query)
        search.run()
        return search.best_plan()


class Search:
    """One batch of trees while it grows."""

    def __init__(self, planner: ElastPlanner, query: Query) -> None:
        self.world, self.config = planner.world(query.context), planner.config
        self.limits, self.radii = planner.limits, planner.radii
        self.query = query
        scenarios = len(query.start)
        self.tally = Tally.zero(scenarios)
        self.draws = self._draw(scenarios)
        self.forest = tree.plant(
            query.start,
            self.world.features(query.start, np.arange(scenarios)),
            query.goal,
            nodes=self.config.expansions + 1,
            extra=self.config.batch_max,
            actions=self.world.action_size,
        )
        self.pairs: Int32 = np.empty((1 << 14, 3), np.int32)
        self.gaps: Float32 = np.empty(1 << 14, np.float32)
        self.done = 0

    def _draw(self, scenarios: int) -> Float64:
        """All random numbers of a plan [B,n,4+A], each row from its own generator."""
        shape = (self.config.expansions, 4 + self.world.action_size)
        seeds = self.query.seed
        return np.stack([generator("plan", int(seeds[b])).random(shape) for b in range(scenarios)])

    def run(self) -> None:
        """Spend the whole budget of expansions."""
        while self.done < self.config.expansions:
            self.expand()

    def expand(self) -> None:
        """One batch: select, step, test, insert, rewire.

        The batch grows with the number of expansions done, since a tree can deepen by no more
        than one step a batch: small batches first, to get deep, then large ones, to be fast.
        """
        config = self.config
        size = int(np.clip(self.done * config.batch_share, config.batch_min, config.batch_max))
        size = min(size, config.expansions - self.done)
        draws = self.draws[:, self.done : self.done + size]
        self.done += size
        batch = self._propose(draws)
        alive = self._admissible(batch)
        pairs, near = self._neighbors(batch, alive)
        self._insert(batch, alive, pairs, near)

    def _propose(self, draws: Float64) -> Batch:
        """Choose nodes to expand and actions, and predict where they lead (Fig. 4 a, b)."""
        config, forest = self.config, self.forest
        scenarios, size = draws.shape[:2]
        parent = np.empty((scenarios, size), np.int32)
        tree.choose(
            forest.crowding,
            forest.size,
            forest.nearest,
            draws,
            (config.p_uniform, config.p_sparse),
            config.sparse_exponent,
            parent,
        )
        row = np.repeat(np.arange(scenarios), size)
        action = self._actions(draws, forest.action[row, parent.ravel()].reshape(*parent.shape, -1))
        z = forest.latent[row, parent.ravel()]
        z_new, variance = self.world.step(z, action.reshape(len(row), -1), row)
        self.tally.transitions += size * self.world.members
        slots = slice(forest.capacity, forest.capacity + size)
        forest.latent[:, slots] = z_new.reshape(scenarios, size, -1)
        features = self.world.features(z_new, row)
        forest.feature[:, slots] = features.reshape(scenarios, size, -1)
        return Batch(parent, action, variance.reshape(scenarios, size), row)

    def _actions(self, draws: Float64, inherited: Float32) -> Float32:
        """Random actions [B,K,A]: uniform, or the parent's own with noise; some scaled to the edge.

        Args:
            draws: [B,K,4+A] in [0, 1): ..., edge?, keep?, direction.
            inherited: action [B,K,A] on the edge into the node that is expanded; 0 at the root.
        """
        config = self.config
        uniform = (2 * draws[..., 4:] - 1).astype(np.float32)
        reach = np.abs(uniform).max(-1, keepdims=True).clip(1e-6)
        uniform = np.where(draws[..., 2:3] < config.edge_actions, uniform / reach, uniform)
        kept = (inherited + config.momentum_noise * uniform).clip(-1, 1)
        keep = (draws[..., 3:4] < config.momentum) & (inherited != 0).any(-1, keepdims=True)
        return np.where(keep, kept, uniform).astype(np.float32)

    def _index(self, row: Int64 | Int32, node: Int64 | Int32) -> Int64:
        """Flat index of nodes into the feature table."""
        index: Int64 = row.astype(np.int64) * self.forest.feature.shape[1] + node
        return index

    def _log_density(self, row: Int64, source: Int64 | Int32, target: Int64 | Int32) -> Float32:
        table = self.forest.feature.reshape(-1, self.forest.feature.shape[2])
        self.tally.density += np.bincount(row, minlength=len(self.tally.density))
        return self.world.log_density(table, self._index(row, source), self._index(row, target))

    def _admissible(self, batch: Batch) -> Bool:
        """Tests of the new transitions: finite, certain, likely, and within the data's support."""
        forest, limits = self.forest, self.limits
        scenarios, size = batch.parent.shape
        slots = np.tile(np.arange(size), scenarios) + forest.capacity
        z_new = forest.latent[batch.row, slots]
        alive = np.isfinite(z_new).all(-1) & (batch.variance.ravel() <= limits.max_variance)
        if limits.min_log_density > -np.inf:
            left = np.flatnonzero(alive)
            row = batch.row[left]
            log_density = self._log_density(row, batch.parent.ravel()[left], slots[left])
            alive[left] = log_density >= limits.min_log_density
        if limits.max_support_distance < np.inf:
            left = np.flatnonzero(alive)
            distance = self.world.support_distance(z_new[left])
            alive[left] = distance <= limits.max_support_distance
        return alive.reshape(scenarios, size)

    def _neighbors(self, batch: Batch, alive: Bool) -> tuple[Int32, Bool]:
        """Pairs (b, k, node) [P,3] within r_neigh, and which crowd each other [P].

        Duplicates are marked dead on the way.
        """
        forest = self.forest
        new_depth = np.take_along_axis(forest.depth, batch.parent.astype(np.int64), 1) + 1
        while True:
            found = tree.find_neighbors(
                forest.latent,
                forest.depth,
                forest.size,
                forest.capacity,
                new_depth.astype(np.int32),
                alive,
                self.radii.neighbor,
                self.radii.duplicate,
                self.pairs,
                self.gaps,
            )
            if found <= len(self.pairs):
                return self.pairs[:found], self.gaps[:found] <= self.radii.crowding**2
            self.pairs = np.empty((2 * found, 3), np.int32)
            self.gaps = np.empty(2 * found, np.float32)

    def _insert(self, batch: Batch, alive: Bool, pairs: Int32, near: Bool) -> None:
        """Add the candidates that passed, then rewire around them (Fig. 4 c-f)."""
        forest, config = self.forest, self.config
        before = forest.size.copy()
        new = np.empty(alive.shape, np.int32)
        tree.insert(
            forest.latent,
            forest.feature,
            forest.action,
            forest.parent,
            forest.depth,
            forest.crowding,
            forest.child,
            forest.after,
            forest.before,
            forest.size,
            alive,
            batch.parent,
            batch.action,
            new,
        )
        row, node = pairs[:, 0], pairs[:, 2]
        added = new[row, pairs[:, 1]]
        if config.count_rejections:
            np.add.at(forest.crowding, (batch.row, batch.parent.ravel()), ~alive.ravel())
        into, out_of = self._count_neighbors(row, added, node, near)
        if config.rewire:
            self._offer(row, node, added, into)
            self._offer(row, added, node, out_of)
        tree.update_nearest(
            forest.latent,
            self.query.goal,
            before,
            forest.size,
            forest.nearest,
            forest.nearest_distance,
        )

    def _count_neighbors(
        self, row: Int32, added: Int32, node: Int32, near: Bool
    ) -> tuple[Bool | None, Bool | None]:
        """Update crowding; where ψ decides it, return which pairs are likely in each direction."""
        forest = self.forest
        if self.config.crowding == "near" or self.limits.min_log_density == -np.inf:
            np.add.at(forest.crowding, (row[near], node[near]), 1)
            np.add.at(forest.crowding, (row[near], added[near]), 1)
            return None, None
        wide = row.astype(np.int64)
        into = self._log_density(wide, node, added) >= self.limits.min_log_density
        out_of = self._log_density(wide, added, node) >= self.limits.min_log_density
        np.add.at(forest.crowding, (row, node), into & near)
        np.add.at(forest.crowding, (row, added), out_of & near)
        return into, out_of

    def _offer(self, row: Int32, source: Int32, target: Int32, likely: Bool | None) -> None:
        """Test the edges that would lower a cost, and take those that pass and still do."""
        forest = self.forest
        keep = forest.depth[row, source] + 1 < forest.depth[row, target]
        if likely is not None:
            keep &= likely
        row, source, target = row[keep], source[keep], target[keep]
        if likely is None and self.limits.min_log_density > -np.inf and len(row):
            log_density = self._log_density(row.astype(np.int64), source, target)
            keep = log_density >= self.limits.min_log_density
            row, source, target = row[keep], source[keep], target[keep]
        order, keep = self._cheapest(row, source, target)
        row, source, target = row[order][keep], source[order][keep], target[order][keep]
        if not len(row):
            return
        action, keep = self._connect(row, source, target)
        edges = np.stack([row, source, target], 1)[keep]
        tree.rewire(
            edges,
            action[keep],
            forest.action,
            forest.parent,
            forest.depth,
            forest.child,
            forest.after,
            forest.before,
        )

    def _cheapest(self, row: Int32, source: Int32, target: Int32) -> tuple[Int64, Bool]:
        """Order edges by target, then cost; keep each target's few cheapest."""
        depth = self.forest.depth[row, source]
        order = np.lexsort((source, depth, target, row))
        same = np.zeros(len(order), bool)
        same[1:] = (np.diff(target[order]) == 0) & (np.diff(row[order]) == 0)
        start = np.maximum.accumulate(np.where(same, 0, np.arange(len(order))))
        return order, np.arange(len(order)) - start < self.config.connect_candidates

    def _connect(self, row: Int32, source: Int32, target: Int32) -> tuple[Float32, Bool]:
        """π's action along each edge [P,A], and whether it lands near enough (round trip)."""
        forest, wide = self.forest, row.astype(np.int64)
        action, miss = self.world.connect(
            forest.latent[row, source], forest.latent[row, target], wide
        )
        calls = np.bincount(wide, minlength=len(self.tally.policy))
        self.tally.policy += calls
        if self.limits.max_round_trip < np.inf:
            self.tally.transitions += calls * self.world.members
        return action, miss <= self.limits.max_round_trip

    def best_nodes(self) -> tuple[Int64, Bool]:
        """The end of each row's path [B], and whether it lies within r_goal of the goal [B].

        The cheapest node within r_goal, the nearer of two; else the node nearest to the goal.
        """
        forest, goal = self.forest, self.query.goal
        nodes = forest.nearest.copy()
        for b in np.flatnonzero(forest.nearest_distance <= self.radii.goal):
            latent = forest.latent[b, : forest.size[b]]
            distance = np.linalg.norm(latent - goal[b], axis=1)
            inside = np.flatnonzero(distance <= self.radii.goal)
            if len(inside):
                order = np.lexsort((distance[inside], forest.depth[b, inside]))
                nodes[b] = inside[order[0]]
        return nodes, forest.nearest_distance <= self.radii.goal

    def best_plan(self) -> Plan:
        """Backtrack from each row's best node."""
        nodes, reached = self.best_nodes()
        forest = self.forest
        paths = [tree.path_to(forest, b, int(node)) for b, node in enumerate(nodes)]
        longest = max(map(len, paths))
        index = np.array([path + [path[-1]] * (longest - len(path)) for path in paths])
        rows = np.arange(len(paths))[:, None]
        return Plan(
            states=forest.latent[rows, index],
            actions=forest.action[rows, index[:, 1:]],
            length=np.array([len(path) for path in paths]),
            reached=reached,
            transitions=self.tally.transitions,
            density_calls=self.tally.density,
            policy_calls=self.tally.policy,
        )


@dataclass(frozen=True)
class Batch:
    """Candidates of one expansion: parent [B,K], action [B,K,A], variance [B,K], row [B·K]."""

    parent: Int32
    action: Float32
    variance: Float32
    row: Int64


__all__ = ["ElastPlanner", "Forest", "Search", "TreeConfig"]
