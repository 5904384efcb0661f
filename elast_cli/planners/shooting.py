"""Shooting: all actions of a path changed at once, so that it ends nearer to the goal.

A tree finds ways round obstacles, but fills seven dimensions far too thinly to end a path on a
given state. The last gap is a least squares problem of few equations and many unknowns: what the
actions are to change by, so that the end of the path moves onto the goal. Gauss-Newton solves it,
with H_f rolled out from the start and Levenberg-Marquardt damping against what is not linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from elast_cli.planners.base import Plan, PlanCost, Query, World
from elast_cli.planners.tree import reuse
from elast_cli.planners.tree.forest import Forest, path_to
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.shapes import Float32, Float64

Step = Callable[[Float32, Float32], Float32]  # z [M,Z], a [M,A] -> z' [M,Z], row by row

DIFFERENCE = 0.1  # of a length unit, and of an action: H_f's kinks and errors are smaller
DAMPINGS = 10.0 ** np.arange(-1, 5)  # tried at once, in units of the last one that helped
FIRST_DAMPING, LEAST_DAMPING = 0.05, 1e-3
FIRST_ITERATIONS = 2  # of all paths of a tree; then half of them get twice as many, and so on
ROUNDS = 3  # in which actions at their bounds are found
BAND, BANDS = 8, 8  # steps of a band of depths, and how many bands have paths refined
NEARER = 0.8  # of the distance that a row stands at: what counts as coming nearer
CLOSE = 0.1  # of a length unit: nearer than that, H_f errs by more
LEAST_GAIN = 1e-3  # share of the squared gap below which another iteration is not worth it


@dataclass(frozen=True)
class Shot:
    """A path under H_f.

    Attributes:
        states, actions: latents [T+1,Z] and actions [T,A].
        gap: how far from the goal it ends, in latent units.
        transitions: steps of H_f that it took to find it.
    """

    states: Float32
    actions: Float32
    gap: float
    transitions: int


def roll(step: Step, start: Float32, actions: Float32) -> Float32:
    """Latents [K,T+1,Z] from start [Z] under actions [K,T,A]."""
    count, length, _ = actions.shape
    states = np.empty((count, length + 1, len(start)), np.float32)
    states[:, 0] = start
    for t in range(length):
        states[:, t + 1] = step(states[:, t], np.ascontiguousarray(actions[:, t]))
    return states


def shot(step: Step, start: Float32, actions: Float32, goal: Float32) -> Shot:
    """The path from start [Z] under actions [T,A] as they are."""
    states = roll(step, start, actions[None])[0]
    return Shot(states, actions, _length(states[-1] - goal), len(actions))


def refined(step: Step, path: Shot, goal: Float32, *, unit: float, iterations: int) -> Shot:
    """The path with actions that make it end nearer to the goal [Z]; never farther from it.

    Args:
        step: H_f; of its rows none may depend on another.
        path: where to begin.
        goal: latent [Z].
        unit: a length that counts as one, such as that of a median step.
        iterations: of Gauss-Newton, at most.
    """
    damping, spent = FIRST_DAMPING, path.transitions
    start, length = path.states[0], len(path.actions)
    inputs = len(start) + path.actions.shape[1]
    for _ in range(iterations if length else 0):
        if path.gap <= CLOSE * unit:
            break
        slope = end_slope(step, path, unit) / unit
        wanted = (goal - path.states[-1]).astype(np.float64) / unit
        dampings = damping * DAMPINGS
        found = [_moved(path.actions, slope, wanted, m) for m in dampings]
        actions = np.stack(found).astype(np.float32)
        states = roll(step, start, actions)
        gaps = [_length(end - goal) for end in states[:, -1]]
        spent += length * (inputs + len(found))
        best = int(np.argmin(gaps))
        gain = 1 - (gaps[best] / path.gap) ** 2
        if not gain > 0:
            break
        path = Shot(states[best], actions[best], gaps[best], spent)
        if gain < LEAST_GAIN:
            break
        damping = max(LEAST_DAMPING, float(dampings[best]))
    return Shot(path.states, path.actions, path.gap, spent)


def end_slope(step: Step, path: Shot, unit: float) -> Float64:
    """How the end of a path moves with its actions [Z,T·A], by differences of H_f.

    Actions are changed towards zero, which never leaves the box.
    """
    z, a = path.states[:-1], path.actions
    length, latents = z.shape
    inputs = np.concatenate([z, a], 1)
    by = np.full(inputs.shape, DIFFERENCE, np.float32)
    by[:, :latents] *= np.float32(unit)
    by[:, latents:] *= np.where(a > 0, np.float32(-1), np.float32(1))
    moved = inputs[:, None] + by[:, None] * np.eye(inputs.shape[1], dtype=np.float32)
    flat = np.ascontiguousarray(moved.reshape(-1, inputs.shape[1]), dtype=np.float32)
    ends = step(np.ascontiguousarray(flat[:, :latents]), np.ascontiguousarray(flat[:, latents:]))
    change = ends.astype(np.float64).reshape(length, -1, latents) - path.states[1:, None]
    slopes = (change / by[..., None].astype(np.float64)).transpose(0, 2, 1)  # [T,Z,Z+A]
    out = np.empty((latents, length, a.shape[1]))
    after = np.eye(latents)
    for t in range(length - 1, -1, -1):
        out[:, t] = after @ slopes[t, :, latents:]
        after = after @ slopes[t, :, :latents]
    return out.reshape(latents, -1)


def _moved(actions: Float32, slope: Float64, wanted: Float64, damping: float) -> Float64:
    """Actions [T,A] within [-1, 1], changed so that the end moves by `wanted` [Z], if linear."""
    flat = actions.ravel().astype(np.float64)
    free = np.ones(len(flat))
    damped = damping * np.eye(len(wanted))
    for _ in range(ROUNDS):
        usable = slope * free
        change = usable.T @ np.linalg.solve(usable @ usable.T + damped, wanted)
        outward = (np.abs(flat) >= 1) & (flat * change > 0) & (free > 0)
        if not outward.any():
            break
        free[outward] = 0
    return np.clip(flat + change, -1, 1).reshape(actions.shape)


def _length(gap: Float32) -> float:
    """Euclidean length of a vector [Z]; infinite where H_f has overflown."""
    length = float(np.sqrt(np.square(gap, dtype=np.float64).sum()))
    return length if np.isfinite(length) else np.inf


@dataclass(frozen=True)
class ShootingPlanner:
    """Trees for the way, shooting for its end.

    What is left of the plan before is refined first: where it still leads to the goal, it is kept,
    and no tree is grown. Else a tree is, and of its paths to the nodes nearest to the goal, each
    of another length, and what is left, all refined, the shortest one is taken that reaches it.

    A path ought to end within `goal` of the goal, and nearer to it than the start by a fifth: who
    stands at the goal by all that latents tell, and yet has to plan, must try to come nearer, or
    go away and come again.

    Attributes:
        tree: grows the trees.
        unit: length of a median step, in latent units.
        goal: how near to the goal a path ought to end, in latent units.
        kept: how near what is left of a plan must end to be kept; no less than `goal`.
    """

    tree: ElastPlanner
    unit: float
    goal: float
    kept: float

    def plan(self, query: Query) -> Plan:
        """One path a query row."""
        world, rows = self.tree.world(query.context), len(query.start)
        kept = self.tree.config.reuse.enabled
        cost = PlanCost.zero(rows)
        memory: list[object] = list(query.memory or [None] * rows)
        paths = [self._continued(world, query, b) for b in range(rows)]
        cost.transitions[:] = [path.transitions * world.members for path in paths]
        left = [self._ends_within(self.kept, paths[b], query, b) for b in range(rows)]
        due = np.flatnonzero(~np.array(left, np.bool_))
        if len(due):
            search = self.tree.grow(query.at(due))
            cost.add(search.cost, due)
            for i, b in enumerate(due.tolist()):
                found = self._from_tree(world, search.forest, i, b)
                cost.transitions[b] += sum(path.transitions for path in found) * world.members
                paths[b] = self._best([paths[b], *found], query, b)
                memory[b] = reuse.remember(search.forest, i) if kept else None
        longest = max(len(path.states) for path in paths)
        reached = np.array([path.gap <= self.tree.radii.goal for path in paths])
        return Plan(
            states=np.stack([_lengthened(path.states, longest) for path in paths]),
            actions=np.stack([_lengthened(path.actions, longest - 1) for path in paths]),
            length=np.array([len(path.states) for path in paths]),
            reached=reached,
            cost=cost,
            memory=memory if kept else (),
            blocked=[
                b
                for b in due.tolist()
                if len(query.failed) and len(query.failed[b]) and not reached[b]
            ],
        )

    def _continued(self, world: World, query: Query, b: int) -> Shot:
        """What is left of row b's plan, refined; staying where it is if nothing is left."""
        left = np.zeros((0, world.action_size), np.float32)
        if query.left is not None:
            played = np.flatnonzero(query.left[b].any(1))
            left = query.left[b, : played[-1] + 1] if len(played) else left
        step, goal = _step(world, b), query.goal[b]
        path = shot(step, query.start[b], np.clip(left, -1, 1), goal)
        iterations = self.tree.config.refine.iterations
        return refined(step, path, goal, unit=self.unit, iterations=iterations)

    def _from_tree(self, world: World, forest: Forest, i: int, b: int) -> list[Shot]:
        """Paths of tree i, which is row b's, to its nodes nearest to the goal, refined.

        All of them by a few iterations, the better half by twice as many more, and so on.
        """
        config, start, goal = self.tree.config, forest.latent[i, 0], forest.goal[i]
        step, paths = _step(world, b), []
        for node in endings(forest, i, config.refine.paths):
            actions = forest.action[i, path_to(forest, i, node)[1:]]
            paths.append(shot(step, start, np.clip(actions, -1, 1), goal))
        dropped: list[Shot] = []
        iterations, left = FIRST_ITERATIONS, config.refine.iterations
        while left > 0 and paths:
            iterations = min(iterations, left)
            paths = [
                refined(step, path, goal, unit=self.unit, iterations=iterations) for path in paths
            ]
            paths.sort(key=lambda path: path.gap)
            half = (len(paths) + 1) // 2
            paths, dropped = paths[:half], dropped + paths[half:]
            left, iterations = left - iterations, 2 * iterations
        return paths + dropped

    def _ends_within(self, radius: float, path: Shot, query: Query, b: int) -> bool:
        """Whether a path of row b ends within a radius of the goal, and nearer than it begins."""
        return path.gap <= min(radius, NEARER * _length(query.start[b] - query.goal[b]))

    def _best(self, paths: list[Shot], query: Query, b: int) -> Shot:
        """The shortest of the paths that arrive; if none does, the one that ends nearest."""
        arriving = [path for path in paths if self._ends_within(self.goal, path, query, b)]
        if arriving:
            return min(arriving, key=lambda path: len(path.actions))
        if _length(query.start[b] - query.goal[b]) <= self.tree.radii.goal:
            away = [path for path in paths if len(path.actions) > BAND]
            paths = away or paths
        return min(paths, key=lambda path: path.gap)


def _step(world: World, b: int) -> Step:
    """H_f in row b's scenario."""

    def step(z: Float32, action: Float32) -> Float32:
        return world.step(z, action, np.full(len(z), b))[0]

    return step


def endings(forest: Forest, b: int, count: int) -> list[int]:
    """Of tree b's nodes nearest to the goal in each band of depths the nearest ones, `count`."""
    size = forest.size[b]
    band, distance = (forest.depth[b, :size] - 1) // BAND, forest.to_goal[b, :size]
    found = []
    for k in range(BANDS):
        nodes = np.flatnonzero(band == k)
        if len(nodes):
            found.append(int(nodes[distance[nodes].argmin()]))
    return sorted(found, key=lambda node: float(distance[node]))[:count]


def _lengthened(x: Float32, length: int) -> Float32:
    """Entries [T,...] up to `length`: the last one again, or zeros where there is none."""
    more = length - len(x)
    last = x[-1:] if len(x) else np.zeros((1, *x.shape[1:]), x.dtype)
    return np.concatenate([x, np.repeat(last, more, 0)])
