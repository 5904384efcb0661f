"""Shortest paths on a map of the data whose edges are tested lazily (as Lazy PRM and LazySP).

The map joins all states that are near each other, also through walls. The search finds a shortest
path and tests all edges that leave its nodes. ψ must find an edge likely, and H_f under π's action
must land at its end. Rejected edges are removed, and the search repeats until all edges of a path
have passed. That path is the shortest one that passes. Most edges are never tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from elast_cli.planners.base import Limits, Plan, PlanCost, Query, Radii, WorldOf, lengthened
from elast_cli.planners.graph.roadmap import Paths, Roadmap, shortest_from
from elast_cli.planners.tree.reuse import closed
from elast_cli.planners.tree.transitions import Transitions
from elast_cli.shapes import Bool, Float32, Int64

UNTESTED, PASSED, REJECTED = np.int8(0), np.int8(1), np.int8(-1)


@dataclass(frozen=True)
class GraphPlanner:
    """Plans by shortest paths on a map; row i of a batch equals a solo run of row i.

    Attributes:
        world: the learned world of scenarios.
        roadmap: the map.
        limits: the tests of an edge.
        radii: of the goal and of what failed.
        edge_tests: most edges that are tested for one plan.
    """

    world: WorldOf
    roadmap: Roadmap
    limits: Limits
    radii: Radii
    edge_tests: int

    def plan(self, query: Query) -> Plan:
        """One path a row."""
        cost = PlanCost.zero(len(query.start))
        transitions = Transitions(self.world(query.context), self.limits, {}, 0.0, cost)
        searches = [LazySearch(self, transitions, query, b) for b in range(len(query.start))]
        paths = [search.path() for search in searches]
        longest = max(len(path) for path in paths)
        states = np.stack([lengthened(path, longest) for path in paths])
        actions = [search.along(path) for search, path in zip(searches, paths, strict=True)]
        ends = np.linalg.norm(states[:, -1] - query.goal, axis=1)
        reached = ends <= self.radii.goal
        return Plan(
            states=states,
            actions=np.stack([lengthened(taken, longest - 1) for taken in actions]),
            length=np.array([len(path) for path in paths]),
            reached=reached,
            cost=cost,
            memory=[search.verdicts for search in searches],
            blocked=[b for b, search in enumerate(searches) if search.failed and not reached[b]],
            nodes=[len(self.roadmap.latents)] * len(paths),
            exhausted=lambda: [search.left > 0 for search in searches],
        )


class LazySearch:
    """The search for one row's path.

    Attributes:
        verdicts: of each edge of the map [E]: untested, passed, or rejected.
        failed: whether a transition failed in execution.
        left: edges that may still be tested.
    """

    def __init__(
        self, planner: GraphPlanner, transitions: Transitions, query: Query, row: int
    ) -> None:
        """Prepare the search of one row; no edge is tested yet.

        Args:
            planner: gives the map, the radii and the number of edge tests.
            transitions: tests edges and counts network calls.
            query: the problems of all rows.
            row: which of them to solve.
        """
        self._map, self._row, self._transitions = planner.roadmap, row, transitions
        self._start, self._goal = query.start[row], query.goal[row]
        self.left = planner.edge_tests
        self.verdicts = _known(self._map, query, row)
        failed = query.failed[row] if query.failed else np.empty((0, 2, 0), np.float32)
        self.failed = len(failed) > 0
        self._open, self._goal_open = np.ones(len(self._map.latents), np.bool_), True
        if self.failed:
            self._open = ~closed(self._map.latents, failed, planner.radii.failure)
            self._goal_open = not closed(self._goal[None], failed, planner.radii.failure)[0]

    def path(self) -> Float32:
        """Latents [T,Z] from the start to the goal, or else to the nearest node with a way.

        The start joins the nodes about it that pass the tests; if none does, the nearest one.
        """
        if self._in_one_step():
            return np.stack([self._start, self._goal])
        joined = self._joined()
        gaps = self._gaps(self._start)
        if not len(joined):
            joined = np.array([np.where(self._open, gaps, np.inf).argmin()])
        length = gaps[joined]
        before_goal = self._before_goal()
        while True:
            paths = shortest_from(self._map, self._usable(), joined, length)
            node, arrives = self._end(paths, before_goal)
            nodes = [] if node is None else paths.to(node)
            if not self._tested(nodes):
                break
        ends = [self._goal[None]] if arrives else []
        return np.concatenate([self._start[None], self._map.latents[nodes], *ends])

    def along(self, path: Float32) -> Float32:
        """π's actions along a path [T,Z]: [T-1,A]."""
        self._transitions.cost.policy_calls[self._row] += len(path) - 1
        row = np.full(len(path) - 1, self._row)
        return self._transitions.world.act(path[:-1], path[1:], row)

    def _in_one_step(self) -> bool:
        """Whether an edge leads from the start to the goal."""
        if not self._goal_open:
            return False
        gap = np.linalg.norm(self._start - self._goal)
        return bool(
            gap <= self._map.radius and self._passes(self._start[None], self._goal[None])[0]
        )

    def _joined(self) -> Int64:
        """Open nodes about the start that it passes on to [J]."""
        near = self._map.near(self._start)
        near = near[self._open[near]]
        start = np.repeat(self._start[None], len(near), axis=0)
        return near[self._passes(start, self._map.latents[near])]

    def _before_goal(self) -> Int64:
        """Open nodes from which one step leads to the goal [J]."""
        near = self._map.near(self._goal)
        near = near[self._open[near] & self._goal_open]
        goal = np.repeat(self._goal[None], len(near), axis=0)
        return near[self._passes(self._map.latents[near], goal)]

    def _gaps(self, z: Float32) -> Float32:
        """Distance of each node to a latent [N]."""
        gaps: Float32 = np.linalg.norm(self._map.latents - z, axis=1)
        return gaps

    def _usable(self) -> Bool:
        """The edges that paths may take [E]."""
        least = UNTESTED if self.left > 0 else PASSED
        usable: Bool = (self.verdicts >= least) & self._open[self._map.target]
        return usable

    def _end(self, paths: Paths, before_goal: Int64) -> tuple[int | None, bool]:
        """The last node of the best path, None where it is the start, and whether it arrives."""
        if len(before_goal):
            last = self._gaps(self._goal)[before_goal]
            cost = paths.cost[before_goal] + self._map.cost(last)
            if np.isfinite(cost).any():
                return int(before_goal[cost.argmin()]), True
        gaps = np.where(np.isfinite(paths.cost), self._gaps(self._goal), np.inf)
        node = int(gaps.argmin())
        nearer = gaps[node] < np.linalg.norm(self._start - self._goal)
        return (node if nearer else None), False

    def _tested(self, nodes: Sequence[int]) -> bool:
        """Whether a path [T] had edges to test; all untested ones that leave its nodes are."""
        source, target = self._map.source, self._map.target
        along = [
            self._map.first[i] + int(np.flatnonzero(target[self._slice(i)] == j)[0])
            for i, j in pairwise(nodes)
        ]
        if not (self.verdicts[along] == UNTESTED).any():
            return False
        about = np.concatenate(
            [np.arange(self._map.first[i], self._map.first[i + 1]) for i in nodes]
        )
        about = about[(self.verdicts[about] == UNTESTED) & self._open[target[about]]]
        latents = self._map.latents
        passes = self._passes(latents[source[about]], latents[target[about]])
        self.verdicts[about] = np.where(passes, PASSED, REJECTED)
        self.left -= len(about)
        return True

    def _slice(self, node: int) -> slice:
        return slice(self._map.first[node], self._map.first[node + 1])

    def _passes(self, z: Float32, z_next: Float32) -> Bool:
        """Which of the transitions from z to z' [P,Z] pass ψ and the round trip [P]."""
        row, transitions = np.full(len(z), self._row), self._transitions
        passes = np.ones(len(z), np.bool_)
        if transitions.asks_density and len(z):
            features = transitions.world.features(np.concatenate([z, z_next]), np.tile(row, 2))
            here = np.arange(len(z))
            likely = transitions.world.log_density(features, here, here + len(z))
            transitions.cost.density_calls[self._row] += len(z)
            passes = likely >= transitions.limits.min_log_density
        if passes.any():
            _, passes[passes] = transitions.round_trip(z[passes], z_next[passes], row[passes])
        return passes


def _known(roadmap: Roadmap, query: Query, row: int) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
    """Verdicts on a row's edges before any is tested [E].

    They are those of the previous plan. Without contexts, observed transitions have passed, too.
    """
    memory = query.memory[row] if query.memory else None
    if isinstance(memory, np.ndarray):
        return memory.copy()
    verdicts = np.full(len(roadmap.source), UNTESTED)
    if not query.context.shape[1]:
        verdicts[roadmap.observed] = PASSED
    return verdicts
