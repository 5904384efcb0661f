"""Our rewiring beside OMPL's RRT* on a plane problem with exact dynamics (`pip install ompl`).

A point in the S-shaped corridor moves straight by at most `RANGE` a step; a motion costs 1. Both
planners get trees of the same number of nodes, the same start, goal and goal radius.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

from benchmarks.document import Figure
from benchmarks.trained import Bench
from elast_cli.planners.base import Limits, Query, Radii
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.search import ElastPlanner, Search
from elast_cli.shapes import Bool, Float32, Float64, Int64

RANGE = 0.07
GOAL_RADIUS = 0.05
START, GOAL = (0.1, 0.1), (0.9, 0.9)
WALLS = np.array([(0.0, 0.31, 0.82, 0.35), (0.18, 0.65, 1.0, 0.69)])


@njit(cache=True)
def _free(a: Float32, b: Float32, walls: Any) -> bool:
    """Whether the segment from a to b stays in the unit square and off the walls (slab test)."""
    for d in range(2):
        if b[d] < 0 or b[d] > 1:
            return False
    for w in range(walls.shape[0]):
        enter, leave = 0.0, 1.0
        for d in range(2):
            step = b[d] - a[d]
            low, high = walls[w, d] - a[d], walls[w, d + 2] - a[d]
            if abs(step) < 1e-12:
                if low > 0 or high < 0:
                    leave = -1.0
            else:
                first, last = low / step, high / step
                enter, leave = max(enter, min(first, last)), min(leave, max(first, last))
        if enter <= leave:
            return False
    return True


@njit(cache=True)
def _all_free(a: Float32, b: Float32, walls: Any, out: Bool) -> None:
    for i in range(len(a)):
        out[i] = _free(a[i], b[i], walls)


@dataclass
class Plane:
    """The corridor as a world to search: ψ is 0 for a possible motion, -1 for any other."""

    latent_size: int = 2
    action_size: int = 2
    feature_size: int = 2
    members: int = 1
    axes: Float64 = field(default_factory=lambda: np.eye(2))

    def at(self, _context: Float32) -> Plane:
        """The same for every context."""
        return self

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """A straight motion; actions beyond the unit disc are scaled back to it."""
        length = np.linalg.norm(action, axis=1, keepdims=True).clip(1)
        following = (z + np.float32(RANGE) * action / length).astype(np.float32)
        return following, np.zeros(len(z), np.float32)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        """Those of a motion inside the unit disc."""
        one = np.eye(2, dtype=np.float32)
        return np.repeat(np.concatenate([one, np.float32(RANGE) * one], 1)[None], len(z), axis=0)

    def features(self, z: Float32, row: Int64) -> Float32:
        """The place itself."""
        return z

    def log_density(self, features: Float32, source: Int64, target: Int64) -> Float32:
        """0 where a motion within `RANGE` is free, else -1."""
        a, b = features[source], features[target]
        free = np.empty(len(a), np.bool_)
        _all_free(a, b, WALLS, free)
        near = np.linalg.norm(b - a, axis=1) <= RANGE * (1 + 1e-5)
        return np.where(free & near, np.float32(0), np.float32(-1))

    def supported(self, z: Float32, limit: float) -> Bool:
        """Everything is supported."""
        return np.ones(len(z), np.bool_)

    def act(self, z: Float32, z_next: Float32, row: Int64) -> Float32:
        """The exact action."""
        return (z_next - z) / np.float32(RANGE)


def ours(nodes: int, seed: int) -> tuple[float, int, float]:
    """Path cost, nodes and seconds of our search grown to `nodes` nodes."""
    config = TreeConfig(expansions=20 * nodes, max_nodes=nodes)
    planner = ElastPlanner(
        Plane().at,
        config,
        Limits(min_log_density=-0.5),
        Radii(neighbor=RANGE, goal=GOAL_RADIUS, crowding=RANGE / 2),
    )
    start, goal = np.array([START], np.float32), np.array([GOAL], np.float32)
    query = Query(start, goal, np.zeros((1, 0), np.float32), np.array([seed]))
    began = time.perf_counter()
    search = Search(planner, query)
    search.run()
    seconds = time.perf_counter() - began
    plan = search.best_plan()
    cost = float(plan.length[0] - 1) if plan.reached[0] else float("inf")
    return cost, int(search.forest.size[0]), seconds


def theirs(nodes: int, _seed: int) -> tuple[float, int, float]:
    """The same of OMPL's RRT*, whose random numbers run on from one call to the next."""
    from ompl import base, geometric

    class Motions(base.OptimizationObjective):  # type: ignore[misc]  # ompl has no types
        """Every motion costs 1."""

        def stateCost(self, _state: Any) -> Any:  # OMPL's name
            return base.Cost(0.0)

        def motionCost(self, _a: Any, _b: Any) -> Any:  # OMPL's name
            return base.Cost(1.0)

    space = base.RealVectorStateSpace(2)
    bounds = base.RealVectorBounds(2)
    bounds.setLow(0.0)
    bounds.setHigh(1.0)
    space.setBounds(bounds)
    info = base.SpaceInformation(space)
    walls = WALLS.tolist()
    info.setStateValidityChecker(
        lambda s: not any(w[0] <= s[0] <= w[2] and w[1] <= s[1] <= w[3] for w in walls)
    )
    info.setStateValidityCheckingResolution(0.005 / space.getMaximumExtent())
    info.setup()
    problem = base.ProblemDefinition(info)
    ends = []
    for place in (START, GOAL):
        state = space.allocState()
        state[0], state[1] = place
        ends.append(state)
    problem.setStartAndGoalStates(ends[0], ends[1], GOAL_RADIUS)
    objective = Motions(info)
    problem.setOptimizationObjective(objective)
    planner = geometric.RRTstar(info)
    planner.setRange(RANGE)
    planner.setProblemDefinition(problem)
    planner.setup()
    data = base.PlannerData(info)
    began, size = time.perf_counter(), 0
    while size < nodes:
        limit = planner.numIterations() + max(1, nodes - size)
        stop = base.PlannerTerminationCondition(lambda: planner.numIterations() >= limit)  # noqa: B023
        planner.solve(stop)
        data = base.PlannerData(info)
        planner.getPlannerData(data)
        size = data.numVertices()
    seconds = time.perf_counter() - began
    exact = problem.hasExactSolution()
    return (planner.bestCost().value() if exact else float("inf")), size, seconds


def figures(bench: Bench) -> list[Figure]:
    """Mean path cost of both, and their ratio; and their rates."""
    names = "our mean path cost over RRT*'s", "our nodes/s over RRT*'s"
    try:
        from ompl import util
    except ImportError:
        note = "not measured: ompl is not installed (pip install -e .[bench])"
        return [Figure(measurement="rrt_star", name=n, ratio=None, note=note) for n in names]
    util.RNG.setSeed(1)
    util.noOutputHandler()
    sizes = bench.sizes
    ours(200, 0)  # compiles
    runs = {
        name: np.array([planner(sizes.nodes, seed) for seed in range(sizes.trees)])
        for name, planner in (("elast", ours), ("ompl", theirs))
    }
    solved = {name: np.isfinite(found[:, 0]) for name, found in runs.items()}
    cost = {name: runs[name][ok, 0].mean() for name, ok in solved.items() if ok.any()}
    rate = {name: found[:, 1].sum() / found[:, 2].sum() for name, found in runs.items()}
    seconds = {f"a tree, {name}": found[:, 2].mean() for name, found in runs.items()}
    counts = " and ".join(f"{ok.sum()}/{sizes.trees}" for ok in solved.values())
    ratios = (
        cost["elast"] / cost["ompl"] if len(cost) == 2 else None,
        rate["elast"] / rate["ompl"],
    )
    facts: dict[str, Any] = {"solved": counts, "nodes": sizes.nodes}
    note = "callbacks of RRT* in Python"
    return [
        Figure(
            measurement="rrt_star", name=name, ratio=ratio, seconds=seconds, facts=facts, note=note
        )
        for name, ratio in zip(names, ratios, strict=True)
    ]
