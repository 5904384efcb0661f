"""What a plan is made of: every edge against every test, in figures and decoded for people."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.methods.elast import planner
from elast_cli.methods.loading import Models
from elast_cli.methods.outcome import outcome
from elast_cli.models.tensors import Array
from elast_cli.planners.base import Plan, Query
from elast_cli.planners.refined_tree import ShootingPlanner
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.forest import path_to
from elast_cli.planners.tree.search import Search
from elast_cli.shapes import Float32, Int32, Int64

Distance = Callable[[Float32, Float32], float]  # of two states, in the environment's unit


@dataclass(frozen=True)
class Explanation:
    """One plan, its tree and its figures.

    Attributes:
        latents: nodes of the tree [N,Z].
        parents: parent of each node [N], -1 at the root.
        path: latents of the plan, from the start on [T,Z].
        rows: dataset row whose encoded state is nearest to each node of the path [T].
        figures: everything about the plan, for JSON.
    """

    latents: Float32
    parents: Int32
    path: Float32
    rows: Int64
    figures: JsonDict


def explain_plan(
    models: Models, config: TreeConfig, query: Query, distance: Distance | None
) -> Explanation:
    """Make the first plan of an episode, for one query row, and account for every edge of it.

    Where shooting refines the paths of the tree, the plan is the refined path, as it is played.
    `distance` of two true states, where the environment has one, separates jumps from true steps.
    """
    whole = planner(models, config)
    trees = whole.tree if isinstance(whole, ShootingPlanner) else whole
    began = time.perf_counter()
    search = trees.grow(query)
    plan = search.best_plan()
    if whole is not trees:  # without a time budget it grows the same tree once more
        began = time.perf_counter()
        plan = whole.plan(query)
    seconds = time.perf_counter() - began
    forest, size = search.forest, int(search.forest.size[0])
    nodes = None if whole is not trees else path_to(forest, 0, int(search.best_nodes()[0][0]))
    states = plan.states[0, : plan.length[0]]
    near = _nearest(models, states)
    ended = outcome(models, plan, query.goal)
    figures: JsonDict = {
        "reached": bool(plan.reached[0]),
        "outcome": {**ended.document(), "text": ended.text},
        "path_by": "tree" if nodes else "shooting",  # or by π, where no tree could grow
        "steps": len(states) - 1,
        "seconds": seconds,
        "nodes": size,
        "expansions": config.expansions,
        "repeatable": config.time_budget is None,
        **{name: int(calls[0]) for name, calls in vars(plan.cost).items()},
        "limits": _finite(asdict(trees.limits)),
        "radii": _finite(asdict(trees.radii)),
        "goal": _goal(models, search, states[-1]),
        "path": [*_path(models, search, plan, nodes, near, distance)],
    }
    rows = _support(models, "rows")[near[0]]
    return Explanation(forest.latent[0, :size], forest.parent[0, :size], states, rows, figures)


def _support(models: Models, name: str) -> Array:
    """Latents [N,Z], dataset rows [N] or states [N,S] of the encoded training states."""
    return models.stored("ensemble").arrays[f"support.{name}"]


def _nearest(models: Models, latents: Float32) -> tuple[Int64, Float32]:
    """Index of the nearest encoded training state of each latent [T], and its distance [T]."""
    support = _support(models, "latents")
    apart = [np.linalg.norm(support - latent, axis=1) for latent in latents]
    return np.array([d.argmin() for d in apart]), np.array([d.min() for d in apart])


def _goal(models: Models, search: Search, end: Float32) -> JsonDict:
    """How well the data cover the goal, and how near the tree and the plan come to it."""
    distance = float(_nearest(models, search.query.goal)[1][0])
    return {
        "support_distance": distance,
        "supported": bool(distance <= search.growth.transitions.limits.max_support_distance),
        "nearest_node_distance": float(search.forest.nearest_distance[0]),
        "plan_end_distance": float(np.linalg.norm(end - search.query.goal[0])),
    }


def _path(
    models: Models,
    search: Search,
    plan: Plan,
    nodes: Sequence[int] | None,
    near: tuple[Int64, Float32],
    distance: Distance | None,
) -> Sequence[JsonDict]:
    """One entry a state of the plan: where it is, and the edge that leads to it.

    `near`: the nearest encoded training state of each, and its distance.
    """
    latent, (nearest, support) = plan.states[0, : plan.length[0]], near
    states = _support(models, "states")[nearest]
    goal = np.linalg.norm(latent - search.query.goal[0], axis=1)
    entries: list[JsonDict] = [
        {
            "node": None if nodes is None else int(nodes[i]),
            "decoded_state": [float(x) for x in states[i]],
            "support_distance": float(support[i]),
            "goal_distance": float(goal[i]),
        }
        for i in range(len(latent))
    ]
    for i, edge in enumerate(_edges(search, latent, plan.actions[0])):
        jump = distance(states[i], states[i + 1]) if distance else None
        entries[i + 1]["edge"] = {**edge, "decoded_jump": jump}
    return entries


def _edges(search: Search, latent: Float32, action: Float32) -> Sequence[JsonDict]:
    """What each test says of the edges between latents [T,Z], made by actions [T-1 or more,A]."""
    world = search.growth.transitions.world
    source, target = np.arange(len(latent) - 1), np.arange(1, len(latent))
    row, action = np.zeros(len(source), np.int64), action[: len(source)]
    features = world.features(latent, np.zeros(len(latent), np.int64))
    log_density = world.log_density(features, source, target)
    landed, variance = world.step(latent[:-1], action, row)
    back, _ = world.step(latent[:-1], world.act(latent[:-1], latent[1:], row), row)
    round_trip = np.linalg.norm(back - latent[1:], axis=1)
    prediction = np.linalg.norm(landed - latent[1:], axis=1)
    return [
        {
            "action": [float(x) for x in action[i]],
            "log_density": float(log_density[i]),
            "variance": float(variance[i]),
            "round_trip": float(round_trip[i]),
            "prediction_error": float(prediction[i]),
        }
        for i in range(len(source))
    ]


def _finite(numbers: dict[str, float]) -> JsonDict:
    """Limits and radii; a test that is switched off is null."""
    return {name: float(x) if np.isfinite(x) else None for name, x in numbers.items()}
