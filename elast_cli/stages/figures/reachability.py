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
from elast_cli.planners.base import World
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.shapes import Float32, Int64
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
    planner = _planner(problem, job)
    support, limit = problem.support, planner.limits.min_log_density
    states = problem.models.stored("ensemble").arrays["support.states"]
    chosen = _nearest_state(states, state) if state else _nearest(support, problem.query.start[0])
    length = radius * step_length(problem.models, 0.5)
    near, apart = _within(support, chosen, length)
    to, back = _densities(planner.world(problem.query.context), support[chosen], support[near])
    (cloud,), name = project_parts([support], fit=support, seed=job.seed)
    title = f"reachability: {job.env}, state {_text(states[chosen])}"
    note = f"{len(near):,} training states within {radius:g} median steps"
    both = to >= limit, back >= limit
    reachability_figure(ReachabilityPicture(cloud, near, chosen, both, title, note, name), file)
    return {
        "projection": name,
        "radius": length,
        "min_log_density": float(limit),
        "chosen": {"support": int(chosen), "state": _plain(states[chosen])},
        "reachable": int(both[0].sum()),
        "reaching": int(both[1].sum()),
        "states": [
            _entry(int(row), states[row], cloud[row], float(apart[row])) | answer
            for row, answer in zip(near, _answers(to, back, limit), strict=True)
        ],
    }


def _planner(problem: Problem, job: Job) -> ElastPlanner:
    """The planner with its τ_t. Raises UsageError: the preset has none."""
    config = method_named("elast").configure(job.config).section(PLANNER, TreeConfig)
    if config.tests.density_quantile is None:
        raise UsageError("planner.tests.density_quantile is null: without τ_t ψ rejects nothing")
    return tree_planner(problem.models, config)


def _within(support: Array, chosen: int, length: float) -> tuple[Int64, Float32]:
    """Indices [K] of the others within a length of one latent, and distances of all to it [N]."""
    apart: Float32 = np.linalg.norm(support - support[chosen], axis=1)
    return np.flatnonzero((apart <= length) & (np.arange(len(support)) != chosen)), apart


def _densities(world: World, one: Float32, others: Float32) -> tuple[Float32, Float32]:
    """ln p of the transitions from one latent [Z] to others [N,Z], and from them to it [N]."""
    table = np.concatenate([one[None], others])
    features = world.features(table, np.zeros(len(table), np.int64))
    here, there = np.zeros(len(others), np.int64), np.arange(1, len(table))
    return world.log_density(features, here, there), world.log_density(features, there, here)


def _entry(row: int, state: Array, xy: Array, distance: float) -> JsonDict:
    """A training state near the chosen one: where it is, and how far."""
    return {"support": row, "state": _plain(state), "distance": distance, "xy": _plain(xy)}


def _answers(to: Float32, back: Float32, limit: float) -> list[JsonDict]:
    """What ψ says of the transitions to states and from them [N]."""
    return [
        {
            "log_density_to": float(there),
            "log_density_from": float(here),
            "reachable": bool(there >= limit),
            "reaching": bool(here >= limit),
        }
        for there, here in zip(to, back, strict=True)
    ]


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
