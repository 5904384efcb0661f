"""Which states near one ψ finds reachable, and from which it finds that one so (Fig. 8a)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import JsonValue

from elast_cli.config import JsonDict
from elast_cli.errors import UsageError
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.table import method_named
from elast_cli.methods.thresholds import step_length
from elast_cli.models.tensors import Array
from elast_cli.pictures.projection import project_parts
from elast_cli.pictures.reachability import ReachabilityPicture, reachability_figure
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.stages.job import PLANNER, Job
from elast_cli.stages.problem import Problem


def reachability(
    problem: Problem, job: Job, radius: float, state: list[float] | None, file: Path
) -> JsonDict:
    """Fig. 8a: training states near a chosen one, by both directions' density against τ_t.

    Args:
        problem: with the context, and with the start, near which the chosen state is by default.
        job: with the preset.
        radius: in median steps.
        state: a true state; the training state nearest to it is chosen.
        file: of the picture.

    Raises:
        UsageError: the state has another size than the environment's, or the preset has no τ_t.
    """
    config = method_named("elast").configure(job.config).section(PLANNER, TreeConfig)
    if config.tests.density_quantile is None:
        raise UsageError("planner.tests.density_quantile is null: without τ_t ψ rejects nothing")
    planner = tree_planner(problem.models, config)
    support, limit = problem.support, planner.limits.min_log_density
    states = problem.models.stored("ensemble").arrays["support.states"]
    chosen = _nearest_state(states, state) if state else _nearest(support, problem.query.start[0])
    length = radius * step_length(problem.models, 0.5)
    apart = np.linalg.norm(support - support[chosen], axis=1)
    near = np.flatnonzero((apart <= length) & (np.arange(len(support)) != chosen))
    world = planner.world(problem.query.context)
    table = np.concatenate([support[chosen][None], support[near]])
    features = world.features(table, np.zeros(len(table), np.int64))
    here, there = np.zeros(len(near), np.int64), np.arange(1, len(table))
    to = world.log_density(features, here, there)
    back = world.log_density(features, there, here)
    (cloud,), name = project_parts([support], fit=support, seed=job.seed)
    picture = ReachabilityPicture(
        support_xy=cloud,
        near=near,
        chosen=chosen,
        reachable=(to >= limit, back >= limit),
        title=f"reachability: {job.env}, state {_text(states[chosen])}",
        note=f"{len(near):,} training states within {radius:g} median steps",
        projection=name,
    )
    reachability_figure(picture, file)
    return {
        "projection": name,
        "radius": length,
        "min_log_density": float(limit),
        "chosen": {"support": int(chosen), "state": _plain(states[chosen])},
        "reachable": int((to >= limit).sum()),
        "reaching": int((back >= limit).sum()),
        "states": [
            {
                "support": int(row),
                "state": _plain(states[row]),
                "distance": float(apart[row]),
                "xy": _plain(cloud[row]),
                "log_density_to": float(to[i]),
                "log_density_from": float(back[i]),
                "reachable": bool(to[i] >= limit),
                "reaching": bool(back[i] >= limit),
            }
            for i, row in enumerate(near)
        ],
    }


def _nearest(rows: Array, to: Array) -> int:
    """Index of the row [N,X] nearest to one [X]."""
    return int(np.linalg.norm(rows - to, axis=1).argmin())


def _nearest_state(states: Array, state: list[float]) -> int:
    """Index of the true state [N,S] nearest to a named one. Raises UsageError: not of size S."""
    if len(state) != states.shape[1]:
        raise UsageError(f"--state: expected {states.shape[1]} numbers, got {len(state)}")
    return _nearest(states, np.array(state, np.float32))


def _plain(row: Array) -> list[JsonValue]:
    return [float(x) for x in row]


def _text(state: Array) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in state) + ")"
