"""What a plan is made of: every edge against every test, in figures and decoded for people."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.loading import Models
from elast_cli.models.tensors import Array
from elast_cli.planners.base import Query
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
        path: node indices from the root on [T].
        rows: dataset row whose encoded state is nearest to each node of the path [T].
        figures: everything about the plan, for JSON.
    """

    latents: Float32
    parents: Int32
    path: Int64
    rows: Int64
    figures: JsonDict


def explain_plan(
    models: Models, config: TreeConfig, query: Query, distance: Distance | None
) -> Explanation:
    """Plan for one query row by the tree and account for every edge of the path.

    `distance` of two true states, where the environment knows one, tells jumps from true steps.
    """
    planner = tree_planner(models, config)
    began = time.perf_counter()
    search = Search(planner, query)
    search.run()
    nodes, reached = search.best_nodes()
    seconds = time.perf_counter() - began
    forest, size = search.forest, int(search.forest.size[0])
    path = np.array(path_to(forest, 0, int(nodes[0])))
    nearest, _ = _nearest(models, forest.latent[0, path])
    figures: JsonDict = {
        "reached": bool(reached[0]),
        "steps": len(path) - 1,
        "seconds": seconds,
        "nodes": size,
        "expansions": config.expansions,
        "repeatable": config.time_budget is None,
        **{name: int(calls[0]) for name, calls in vars(search.cost).items()},
        "limits": _finite(asdict(planner.limits)),
        "radii": _finite(asdict(planner.radii)),
        "goal": _goal(models, search),
        "path": [*_path(models, search, path, nearest, distance)],
    }
    rows = _support(models, "rows")[nearest]
    return Explanation(forest.latent[0, :size], forest.parent[0, :size], path, rows, figures)


def _support(models: Models, name: str) -> Array:
    """Latents [N,Z], dataset rows [N] or states [N,S] of the encoded training states."""
    return models.stored("ensemble").arrays[f"support.{name}"]


def _nearest(models: Models, latents: Float32) -> tuple[Int64, Float32]:
    """Index of the nearest encoded training state of each latent [T], and its distance [T]."""
    support = _support(models, "latents")
    apart = [np.linalg.norm(support - latent, axis=1) for latent in latents]
    return np.array([d.argmin() for d in apart]), np.array([d.min() for d in apart])


def _goal(models: Models, search: Search) -> JsonDict:
    """How well the data cover the goal, and how near the tree came to it."""
    distance = float(_nearest(models, search.query.goal)[1][0])
    return {
        "support_distance": distance,
        "supported": bool(distance <= search.growth.transitions.limits.max_support_distance),
        "nearest_node_distance": float(search.forest.nearest_distance[0]),
    }


def _path(
    models: Models, search: Search, path: Int64, nearest: Int64, distance: Distance | None
) -> Sequence[JsonDict]:
    """One entry a node: where it is, and the edge that leads to it."""
    forest, world = search.forest, search.growth.transitions.world
    latent = forest.latent[0, path]
    row = np.zeros(len(path), np.int64)
    states = _support(models, "states")[nearest]
    features = world.features(latent, row)
    source, target = np.arange(len(path) - 1), np.arange(1, len(path))
    log_density = world.log_density(features, source, target)
    action = forest.action[0, path]
    landed, variance = world.step(latent[:-1], action[1:], row[1:])
    back, _ = world.step(latent[:-1], world.act(latent[:-1], latent[1:], row[1:]), row[1:])
    round_trip = np.linalg.norm(back - latent[1:], axis=1)
    prediction = np.linalg.norm(landed - latent[1:], axis=1)
    _, support = _nearest(models, latent)
    goal = np.linalg.norm(latent - search.query.goal[0], axis=1)
    entries: list[JsonDict] = []
    for i in range(len(path)):
        entry: JsonDict = {
            "node": int(path[i]),
            "decoded_state": [float(x) for x in states[i]],
            "support_distance": float(support[i]),
            "goal_distance": float(goal[i]),
        }
        if i:
            entry["edge"] = {
                "action": [float(x) for x in action[i]],
                "log_density": float(log_density[i - 1]),
                "variance": float(variance[i - 1]),
                "round_trip": float(round_trip[i - 1]),
                "prediction_error": float(prediction[i - 1]),
                "decoded_jump": distance(states[i - 1], states[i]) if distance else None,
            }
        entries.append(entry)
    return entries


def _finite(numbers: dict[str, float]) -> JsonDict:
    """Limits and radii; a test that is switched off is null."""
    return {name: float(x) if np.isfinite(x) else None for name, x in numbers.items()}
