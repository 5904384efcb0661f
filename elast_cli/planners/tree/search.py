"""ELAST: grow and rewire trees through latent space towards a goal (Sec. 4.3, Fig. 4)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from elast_cli.config import StrictModel
from elast_cli.planners import grid
from elast_cli.planners.base import Limits, Plan, Query, Radii, WorldOf
from elast_cli.planners.tree import forest as tree
from elast_cli.planners.tree import reuse
from elast_cli.planners.tree import selection as sampling
from elast_cli.planners.tree import siblings as mates
from elast_cli.planners.tree.forest import Forest
from elast_cli.planners.tree.reuse import Memory
from elast_cli.planners.tree.selection import Sparsity
from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

CELLS_PER_RADIUS = 2  # of r_neigh, in the neighbour search


class TreeConfig(StrictModel):
    """The search. The three p are the paper's; what it does not state is ours: docs/explanation/method.md.

    `max_nodes` bounds a tree's memory: a full tree stops. A `time_budget` in seconds stops all
    trees; which plan it leaves depends on the machine. With `reuse`, replanning starts from the
    tree of the plan before, and spends `replan_expansions` once that reaches the goal. It keeps no
    more than `max_nodes`, or twice `expansions`, of that tree; one that does not reach the goal
    and leaves less than half of this free gives way to a new one.

    π proposes a share `steer_goal` of the actions, towards the goal, and a share `steer_sparse`
    towards another sparse node. With `prune`, nodes that cannot shorten the path any more are not
    chosen for being sparse, and a tree without any others stops. It takes for granted that no step
    is longer than `Radii.longest`, which for trained models is a little more than any observed.

    With `refine`, the actions of `refine_paths` paths are changed, in as many iterations at most,
    so that they end nearer to the goal, if possible within `refine_goal_steps` median steps of it.
    What is left of a plan is kept as long as it can be refined to end within `refine_kept_steps`.
    """

    expansions: int = Field(default=12_000, ge=1)
    reuse: bool = True
    replan_expansions: int = Field(default=2_000, ge=1)
    max_nodes: int | None = Field(default=None, ge=1)
    time_budget: float | None = Field(default=None, gt=0)
    batch_min: int = Field(default=16, ge=1)
    batch_max: int = Field(default=128, ge=1)
    batch_share: float = Field(default=1 / 16, ge=0, le=1)
    p_uniform: float = Field(default=0.2, ge=0, le=1)
    p_sparse: float = Field(default=0.78, ge=0, le=1)
    sparse_exponent: float = Field(default=3.0, ge=0)
    crowding: Literal["near", "reachable"] = "near"
    count_rejections: bool = True
    edge_actions: float = Field(default=0.5, ge=0, le=1)
    momentum: float = Field(default=0.5, ge=0, le=1)
    momentum_noise: float = Field(default=0.3, ge=0)
    steer_goal: float = Field(default=0.0, ge=0, le=1)
    steer_sparse: float = Field(default=0.0, ge=0, le=1)
    prune: bool = True
    rewire: bool = True
    connect_candidates: int = Field(default=3, ge=1)
    use_ensemble: bool = True
    density_quantile: float | None = Field(default=0.02, ge=0, lt=1)
    variance_quantile: float | None = Field(default=0.99, gt=0, le=1)
    support_quantile: float | None = Field(default=0.99, gt=0, le=1)
    round_trip_quantile: float | None = Field(default=0.95, gt=0, le=1)
    neighbor_quantile: float = Field(default=0.95, gt=0, le=1)
    crowding_steps: float | None = Field(default=0.5, gt=0)
    goal_steps: float = Field(default=1.0, gt=0)
    duplicate_steps: float = Field(default=0.2, ge=0)
    failure_steps: float = Field(default=1.2, ge=0)
    refine: int = Field(default=0, ge=0)
    refine_paths: int = Field(default=6, ge=1)
    refine_goal_steps: float = Field(default=0.6, ge=0)
    refine_kept_steps: float = Field(default=1.25, ge=0)

    @model_validator(mode="after")
    def _shares_and_batches(self) -> TreeConfig:
        if self.p_uniform + self.p_sparse > 1 + 1e-9:
            raise ValueError("p_uniform + p_sparse must not exceed 1; the rest is p_goal")
        if self.steer_goal + self.steer_sparse > 1 + 1e-9:
            raise ValueError("steer_goal + steer_sparse must not exceed 1")
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
        return self.grow(query).best_plan()

    def grow(self, query: Query) -> Search:
        """Grow a tree for each row."""
        search = Search(self, query)
        search.run()
        return search


class Search:
    """One batch of trees while it grows."""

    def __init__(self, planner: ElastPlanner, query: Query) -> None:
        self.began = time.monotonic()
        self.world, self.config = planner.world(query.context), planner.config
        self.limits, self.radii = planner.limits, planner.radii
        self.query = query
        config, scenarios = self.config, len(query.start)
        self.tally = Tally.zero(scenarios)
        self.draws = sampling.Draws(query.seed, tree.DIRECTION + self.world.action_size)
        self.later = np.array(
            [config.reuse and m is not None for m in query.memory or [None] * scenarios]
        )
        self.failures = {b: pairs for b, pairs in enumerate(query.failed) if len(pairs)}
        roots = self.world.features(query.start, np.arange(scenarios))
        old = [self._replanted(b, roots[b]) for b in range(scenarios)]
        self.budget = np.array([self._budget(b, found) for b, found in enumerate(old)])
        needed = max(len(found.depth) + n for found, n in zip(old, self.budget, strict=True))
        nodes = min(config.max_nodes or needed, needed)
        self.forest = tree.plant(
            query.start,
            roots,
            query.goal,
            nodes=nodes,
            extra=config.batch_max,
            actions=self.world.action_size,
        )
        for b, found in enumerate(old):
            reuse.restore(self.forest, b, found)
        self.cells = grid.empty_cells(
            scenarios, nodes, axes=self.world.axes, side=self.radii.neighbor / CELLS_PER_RADIUS
        )
        self.sparsity = Sparsity(
            sampling.no_weights(scenarios, nodes),
            self.forest.crowding,
            sampling.weight_table(config.sparse_exponent),
        )
        self._admit(np.zeros(scenarios, np.int64))
        self.pairs: Int32 = np.empty((3, 1 << 14), np.int32)
        self.gaps: Float32 = np.empty(1 << 14, np.float32)
        self.done = 0

    def _replanted(self, b: int, feature: Float32) -> Memory:
        """The tree of row b's plan before, hung from where it is now; one node without it."""
        root = self.query.start[b]
        memory = self.query.memory[b] if self.config.reuse and self.query.memory else None
        if not isinstance(memory, Memory):
            return reuse.alone(root, feature, self.world.action_size)
        if b in self.failures:
            memory = reuse.without(memory, self.failures[b], self.radii.failure)
        near = reuse.candidates(memory, root, self.radii.neighbor)
        row = np.full(len(near), b)
        if self.limits.min_log_density > -np.inf and len(near):
            table = np.concatenate([feature[None], memory.feature[near]])
            here = np.zeros(len(near), np.int64)
            log_density = self.world.log_density(table, here, here + np.arange(1, len(near) + 1))
            self.tally.density[b] += len(near)
            near = near[log_density >= self.limits.min_log_density]
            row = row[: len(near)]
        if not len(near):
            return reuse.alone(root, feature, self.world.action_size)
        start = np.repeat(root[None], len(near), axis=0)
        action, admissible = self._round_trip(start, memory.latent[near], row)
        found = reuse.transplant(memory, root, feature, near[admissible], action[admissible])
        room = self.config.max_nodes or 2 * self.config.expansions  # bounds an episode's memory
        return reuse.fitted(found, self.query.goal[b], self.radii.goal, room)

    def _budget(self, b: int, found: Memory) -> int:
        """Expansions of row b: few where the tree that is there already reaches the goal."""
        if len(found.depth) == 1:
            return self.config.expansions
        warm = min(self.config.replan_expansions, self.config.expansions)
        reached = reuse.reaches(found, self.query.goal[b], self.radii.goal)
        return warm if reached else self.config.expansions

    def run(self) -> None:
        """Spend the budget of expansions, or of time since the search began."""
        seconds = self.config.time_budget or np.inf
        forest = self.forest
        while time.monotonic() - self.began < seconds:
            open_ended = (forest.size < forest.capacity) & (self.sparsity.sums[:, 1] > 0)
            rows = np.flatnonzero(open_ended & (self.done < self.budget))
            if not len(rows):
                break
            self.expand(rows)
            arrived = self.later & (forest.nearest_distance <= self.radii.goal)
            enough = self.done + self.config.replan_expansions
            self.budget[arrived] = np.minimum(self.budget[arrived], enough)

    def expand(self, rows: Int64) -> None:
        """One batch in the trees of `rows` [R]: select, step, test, insert, rewire.

        The batch grows with the number of expansions done, since a tree can deepen by no more
        than one step a batch: small batches first, to get deep, then large ones, to be fast.
        """
        config = self.config
        size = int(np.clip(self.done * config.batch_share, config.batch_min, config.batch_max))
        for stop in (config.replan_expansions, config.expansions):  # of any row, so of every row
            size = min(size, stop - self.done) if self.done < stop else size
        draws = self.draws.take(size)[rows]
        self.done += size
        batch = self._propose(rows, draws)
        self._test(batch)
        self._insert(batch)

    def _propose(self, rows: Int64, draws: Float64) -> Batch:
        """Choose nodes to expand and actions, and predict where they lead (Fig. 4 a, b)."""
        config, forest = self.config, self.forest
        shares = (config.p_uniform, config.p_sparse)
        parent = sampling.choose(
            self.sparsity.sums, rows, forest.size, forest.nearest, draws, shares
        )
        z, action = tree.propose(
            forest,
            rows,
            parent,
            draws,
            config.edge_actions,
            config.momentum,
            config.momentum_noise,
        )
        row = np.repeat(rows, parent.shape[1])
        if config.steer_goal + config.steer_sparse > 0:
            self._steer(z, action.reshape(len(row), -1), row, draws.reshape(len(row), -1))
        z_new, variance = self.world.step(z, action.reshape(len(row), -1), row)
        self.tally.transitions[rows] += parent.shape[1] * self.world.members
        alive = np.isfinite(z_new).all(-1) & (variance <= self.limits.max_variance)
        if self.failures:
            alive &= ~self._closed(z_new, row)
        shape = parent.shape
        return Batch(rows, parent, action, z_new.reshape(*shape, -1), alive.reshape(shape))

    def _steer(self, z: Float32, action: Float32, row: Int64, draws: Float64) -> None:
        """Let π choose some of the actions [M,A] at nodes z [M,Z], from draws [M,6+A]."""
        config, forest, reach = self.config, self.forest, self.radii.neighbor
        chance = draws[:, 4]
        steered = chance < config.steer_goal + config.steer_sparse
        target = forest.goal[row[steered]]
        for m in np.flatnonzero(chance[steered] >= config.steer_goal):
            b, where = row[steered][m], draws[steered, 5][m]
            target[m] = forest.latent[b, sampling.draw(self.sparsity.sums[b], where)]
        here = z[steered]
        step = target - here
        step *= np.minimum(1, reach / np.maximum(tree.lengths(step), 1e-9))[:, None]
        action[steered] = self.world.act(here, here + step, row[steered])
        tree.count(self.tally.policy, row[steered], 1)

    def _test(self, batch: Batch) -> None:
        """Clear `alive` where a candidate copies a node or fails a test; cheap tests come first.

        Mates are compared last, so that no candidate gives way to one that is not inserted.
        """
        forest, limits, alive = self.forest, self.limits, batch.alive
        cost = forest.depth[batch.rows[:, None], batch.parent] + 1
        grid.drop_copies(
            self.cells,
            batch.rows,
            batch.latent,
            alive,
            self.radii.duplicate,
            forest.depth,
            cost,
        )
        r, k = np.nonzero(alive)
        z = batch.latent[r, k]
        if limits.max_support_distance < np.inf:
            passed = self.world.supported(z, limits.max_support_distance)
            alive[r, k] = passed
            r, k, z = r[passed], k[passed], z[passed]
        row, slot = batch.rows[r], k + forest.capacity
        forest.feature[row, slot] = self.world.features(z, row)
        if limits.min_log_density > -np.inf:
            alive[r, k] = self._likely(row, batch.parent[r, k], slot)
        mates.drop_copies(batch.latent, alive, cost, self.radii.duplicate)

    def _likely(self, row: Int64 | Int32, source: Int32, target: Int64 | Int32) -> Bool:
        """Whether ψ finds the edges likely [P]."""
        table = self.forest.feature.reshape(-1, self.forest.feature.shape[2])
        width = self.forest.feature.shape[1]
        here, there = tree.flat(row, source, target, width, self.tally.density)
        likely: Bool = self.world.log_density(table, here, there) >= self.limits.min_log_density
        return likely

    def _insert(self, batch: Batch) -> None:
        """Add the candidates that passed, then rewire around them (Fig. 4 c-f)."""
        forest, config = self.forest, self.config
        pairs, gaps = self._pairs(batch)
        before = forest.size.copy()
        new = tree.insert(forest, batch.rows, batch.latent, batch.alive, batch.parent, batch.action)
        self._admit(before)
        edges, gap = tree.edges_around(pairs, gaps, new, forest.capacity)
        likely: Bool | None = None
        counted = edges, gap
        if config.crowding == "reachable" and self.limits.min_log_density > -np.inf:
            likely = self._likely(*edges)
            counted = edges[:, likely], gap[likely]
        sampling.crowd_along(self.sparsity, *counted, self.radii.crowding**2)
        if config.count_rejections:
            sampling.crowd_rejected(self.sparsity, batch.rows, batch.alive, batch.parent)
        if config.rewire:
            self._offer(edges, gap, likely)
        if config.prune:
            goal, longest = self.radii.goal, self.radii.longest
            sampling.prune(self.sparsity, forest, batch.rows, goal, longest)

    def _pairs(self, batch: Batch) -> tuple[Int32, Float32]:
        """Pairs (row, k, node) [3,P] within r_neigh of live candidates, and their squared gaps.

        Pairs with nodes of the trees come first, then those of mates: mate j is node N + j.
        """
        while True:
            found = grid.find_pairs(
                self.cells,
                batch.rows,
                batch.latent,
                batch.alive,
                self.radii.neighbor,
                self.pairs,
                self.gaps,
            )
            found = mates.add_pairs(
                batch.rows,
                batch.latent,
                batch.alive,
                self.radii.neighbor,
                self.forest.capacity,
                self.pairs,
                self.gaps,
                found,
            )
            if found <= len(self.gaps):
                return self.pairs[:, :found], self.gaps[:found]
            self.pairs = np.empty((3, 2 * found), np.int32)
            self.gaps = np.empty(2 * found, np.float32)

    def _admit(self, before: Int64) -> None:
        """Let the nodes added since sizes were `before` [B] be found and drawn."""
        grid.add(self.cells, self.forest.latent, before, self.forest.size)
        sampling.admit(self.sparsity, before, self.forest.size)

    def _offer(self, edges: Int32, gap: Float32, likely: Bool | None) -> None:
        """Rewire targets to the cheapest sources that pass the tests, trying the cheapest first.

        New nodes settle on a parent first; from the second round on they are offered as parents.

        Args:
            edges: (row, source, target) [3,2P]: P into new nodes, then the same reversed.
            gap: their squared lengths [2P].
            likely: what ψ says of them [2P], if it has been asked.
        """
        forest, half = self.forest, len(gap) // 2
        untried = np.ones(2 * half, np.bool_) if likely is None else likely
        ask = likely is None and self.limits.min_log_density > -np.inf
        reverse, untried[half:] = untried[half:].copy(), False
        for attempt in range(1 + self.config.connect_candidates):
            if attempt == 1:
                untried[half:] = reverse
            row, source, target = tree.pick(forest, edges, gap, untried)
            if attempt and not len(row):
                return
            if ask and len(row):
                passed = self._likely(row, source, target)
                row, source, target = row[passed], source[passed], target[passed]
            if len(row):
                ends = tree.ends(forest, row, source, target)
                action, admissible = self._round_trip(*ends)
                tree.rewire(forest, row, source, target, action, admissible)

    def _closed(self, z: Float32, row: Int64) -> Bool:
        """Which places [M] execution could not get to."""
        out = np.zeros(len(row), np.bool_)
        for b, failed in self.failures.items():
            at = np.flatnonzero(row == b)
            out[at] = reuse.closed(z[at], failed, self.radii.failure)
        return out

    def _round_trip(self, z: Float32, z_next: Float32, row: Int64) -> tuple[Float32, Bool]:
        """π's action from z to z' [M,A], and whether H_f under it surely leads there [M]."""
        limits = self.limits
        action = self.world.act(z, z_next, row)
        tree.count(self.tally.policy, row, 1)
        if limits.max_round_trip < np.inf:
            landed, variance = self.world.step(z, action, row)
            tree.count(self.tally.transitions, row, self.world.members)
            bounds = (limits.max_round_trip, limits.max_variance)
            admissible = tree.lands(landed, z_next, variance, *bounds)
        else:
            admissible = np.ones(len(row), np.bool_)
        if self.failures:
            admissible &= ~self._closed(z_next, row)
        return action, admissible

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
            repeatable=self.config.time_budget is None,
            memory=[reuse.remember(forest, b) for b in rows[:, 0]] if self.config.reuse else (),
            barred=[b for b in self.failures if not reached[b]],
        )


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


__all__ = ["ElastPlanner", "Forest", "Search", "TreeConfig"]
