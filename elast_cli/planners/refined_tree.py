"""Trees for the way, shooting for its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elast_cli.planners.base import Plan, PlanCost, Query, World, lengthened
from elast_cli.planners.shooting import NEARER, Shot, length, refined, shots
from elast_cli.planners.tree import reuse
from elast_cli.planners.tree.forest import Forest, path_to
from elast_cli.planners.tree.search import ElastPlanner, Search
from elast_cli.shapes import Float32, Int64

FIRST_ITERATIONS = 2  # of all paths of a tree; then half of them get twice as many, and so on
BAND, BANDS = 8, 8  # steps of a band of depths, and how many bands have paths refined
AWAY = 4  # steps that π leads where no tree can grow


@dataclass(frozen=True)
class ShootingPlanner:
    """Trees for the way, shooting for its end.

    The rest of the previous plan is refined first. While it leads to the goal, it is kept, and no
    tree is grown. Otherwise a tree is grown. Its paths to the nodes nearest to the goal, each of
    another length, are refined, and so is the rest. The shortest path that arrives is taken.

    A path arrives if it ends within `goal` of the goal, and a fifth nearer to it than the start. If
    the agent is near the goal without success, it must come nearer, or back off and try again.

    Attributes:
        tree: grows the trees.
        unit: length of a median step, in latent units.
        goal: how near to the goal a path that arrives ends, in latent units.
        kept: how near what is left of a plan must end to be kept; no less than `goal`.
    """

    tree: ElastPlanner
    unit: float
    goal: float
    kept: float

    def plan(self, query: Query) -> Plan:
        """One path a query row."""
        world, rows = self.tree.world(query.context), len(query.start)
        cost = PlanCost.zero(rows)
        memory: list[object] = list(query.memory or [None] * rows)
        paths = self._continued(world, query)
        cost.transitions[:] = [path.transitions for path in paths]
        left = [self._ends_within(self.kept, paths[b], query, b) for b in range(rows)]
        due = np.flatnonzero(~np.array(left, np.bool_))
        search = self.tree.grow(query.at(due)) if len(due) else None
        if search:
            cost.add(search.cost, due)
            for b, found in self._from_trees(world, search, due).items():
                cost.transitions[b] += sum(path.transitions for path in found)
                paths[b] = self._best([paths[b], *found], query, b)
            self._lead_away(world, query, paths, due, cost)
            if self.tree.config.reuse.enabled:
                for i, b in enumerate(due.tolist()):
                    memory[b] = reuse.remember(search.forest, i)
        return self._as_plan(query, paths, cost, memory, due, search)

    def _as_plan(
        self,
        query: Query,
        paths: Sequence[Shot],
        cost: PlanCost,
        memory: Sequence[object],
        due: Int64,
        search: Search | None,
    ) -> Plan:
        """The plan of one path a row; `search` grew trees for the rows `due`."""
        nodes = np.zeros(len(paths), np.int64)
        if search:
            nodes[due] = search.forest.size

        def exhausted() -> list[bool]:
            asked = search.exhausted().tolist() if search else []
            found = dict(zip(due.tolist(), asked, strict=True))
            return [found.get(b, False) for b in range(len(paths))]

        longest = max(len(path.states) for path in paths)
        reached = np.array([path.gap <= self.tree.radii.goal for path in paths])
        failed = query.failed or [np.empty(0, np.float32)] * len(paths)
        return Plan(
            states=np.stack([lengthened(path.states, longest) for path in paths]),
            actions=np.stack([lengthened(path.actions, longest - 1) for path in paths]),
            length=np.array([len(path.states) for path in paths]),
            reached=reached,
            cost=cost,
            memory=memory if self.tree.config.reuse.enabled else (),
            blocked=[b for b in due.tolist() if len(failed[b]) and not reached[b]],
            nodes=nodes.tolist(),
            exhausted=exhausted,
        )

    def _continued(self, world: World, query: Query) -> list[Shot]:
        """What is left of each row's plan, refined; staying where it is if nothing is left."""
        left = [np.zeros((0, world.action_size), np.float32)] * len(query.start)
        if query.left is not None:
            for b, actions in enumerate(query.left):
                played = np.flatnonzero(actions.any(1))
                left[b] = np.clip(actions[: played[-1] + 1 if len(played) else 0], -1, 1)
        rows = np.arange(len(left))
        paths = shots(world, query.start, left, query.goal, rows)
        return refined(world, paths, unit=self.unit, iterations=self.tree.config.refine.iterations)

    def _lead_away(
        self, world: World, query: Query, paths: list[Shot], due: Int64, cost: PlanCost
    ) -> None:
        """Let π lead rows whose tree could not leave its root, because the tests reject all edges.

        The agent is at this state, so it must be able to leave it.
        """
        rows = np.array([b for b in due if not len(paths[b].actions)], np.int64)
        if not len(rows):
            return
        z, goal, taken = query.start[rows], query.goal[rows], []
        for _ in range(AWAY):
            step = goal - z
            far = np.maximum(np.linalg.norm(step, axis=1, keepdims=True) / self.unit, 1)
            taken.append(world.act(z, (z + step / far).astype(np.float32), rows))
            z, _ = world.step(z, taken[-1], rows)
        actions = list(np.clip(np.stack(taken, axis=1), -1, 1))
        cost.policy_calls[rows] += AWAY
        cost.transitions[rows] += AWAY * world.members
        for path in shots(world, query.start[rows], actions, goal, rows):
            cost.transitions[path.row] += path.transitions
            paths[path.row] = path

    def _from_trees(self, world: World, search: Search, due: Int64) -> dict[int, list[Shot]]:
        """Paths of each tree to its nodes nearest to the goal, refined, by row of the query.

        All of them by a few iterations, the better half by twice as many more, and so on.
        """
        config, forest = self.tree.config.refine, search.forest
        nodes = [(i, n) for i in range(len(due)) for n in endings(forest, i, config.paths)]
        tree = np.array([i for i, _ in nodes], np.int64)
        actions = [np.clip(_actions_to(forest, i, node), -1, 1) for i, node in nodes]
        paths = shots(world, forest.latent[tree, 0], actions, forest.goal[tree], due[tree])
        by_row = {int(b): [path for path in paths if path.row == b] for b in due}
        dropped: dict[int, list[Shot]] = {b: [] for b in by_row}
        iterations, left = FIRST_ITERATIONS, config.iterations
        while left > 0:
            iterations = min(iterations, left)
            every = [path for of_row in by_row.values() for path in of_row]
            every = refined(world, every, unit=self.unit, iterations=iterations)
            for b in by_row:
                ours = sorted((p for p in every if p.row == b), key=lambda path: path.gap)
                half = (len(ours) + 1) // 2
                by_row[b], dropped[b] = ours[:half], dropped[b] + ours[half:]
            left, iterations = left - iterations, 2 * iterations
        return {b: by_row[b] + dropped[b] for b in by_row}

    def _ends_within(self, radius: float, path: Shot, query: Query, b: int) -> bool:
        """Whether a path of row b ends within a radius of the goal, and nearer than it begins."""
        return path.gap <= min(radius, NEARER * length(query.start[b] - query.goal[b]))

    def _best(self, paths: list[Shot], query: Query, b: int) -> Shot:
        """The shortest of the paths that arrive; if none does, the one that ends nearest."""
        arriving = [path for path in paths if self._ends_within(self.goal, path, query, b)]
        if arriving:
            return min(arriving, key=lambda path: len(path.actions))
        if length(query.start[b] - query.goal[b]) <= self.tree.radii.goal:
            away = [path for path in paths if len(path.actions) > BAND]
            paths = away or paths
        return min(paths, key=lambda path: path.gap)


def _actions_to(forest: Forest, i: int, node: int) -> Float32:
    """Actions [T,A] from the root of tree i to a node."""
    actions: Float32 = forest.action[i, path_to(forest, i, node)[1:]]
    return actions


def endings(forest: Forest, b: int, count: int) -> list[int]:
    """Of tree b's nodes nearest to the goal in each band of depths the nearest ones, `count`.

    Args:
        forest: the trees.
        b: index of the tree.
        count: most nodes to return.

    Returns:
        Indices of nodes, the nearest to the goal first. The root is never among them.
    """
    size = forest.size[b]
    band, distance = (forest.depth[b, :size] - 1) // BAND, forest.to_goal[b, :size]
    found = []
    for k in range(BANDS):
        nodes = np.flatnonzero(band == k)
        if len(nodes):
            found.append(int(nodes[distance[nodes].argmin()]))
    return sorted(found, key=lambda node: float(distance[node]))[:count]
