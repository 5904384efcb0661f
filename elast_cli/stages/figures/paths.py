"""A path with data frames, beside one that is found without rejection (App. D.9, Fig. 8b)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.data.dataset import Dataset
from elast_cli.data.images import Images
from elast_cli.methods.explain import Explanation, explain_plan
from elast_cli.methods.table import method_named
from elast_cli.methods.thresholds import limits
from elast_cli.models.tensors import Array
from elast_cli.pictures.paths import PathPicture, PathsPicture, paths_figure
from elast_cli.pictures.plane import Points
from elast_cli.pictures.projection import project_parts
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.job import PLANNER, Job
from elast_cli.stages.problem import Problem

METHODS = ("elast", "elast-no-density")
MOST_FRAMES = 22  # of a path


def paths(problem: Problem, job: Job, dataset: Path, file: Path) -> JsonDict:
    """App. D.9 and Fig. 8b: two paths, and which of their edges lie below τ_t of `elast`.

    Args:
        problem: start and goal.
        job: with the preset.
        dataset: folder of the dataset.
        file: of the picture.
    """
    configs = [
        method_named(name).configure(job.config).section(PLANNER, TreeConfig) for name in METHODS
    ]
    limit = limits(problem.models, configs[0]).min_log_density
    plans = [
        explain_plan(problem.models, config, problem.query, problem.distance) for config in configs
    ]
    rejected = [rejected_steps(plan.figures, limit) for plan in plans]
    support, query = problem.support, problem.query
    parts = [support, query.start, query.goal, *(plan.path for plan in plans)]
    (cloud, start, goal, *lines), name = project_parts(parts, fit=support, seed=job.seed)
    pixels = Dataset.load(dataset / DATASET_FILE).pixels
    columns = [_column(*one, pixels) for one in zip(METHODS, plans, rejected, lines, strict=True)]
    picture = PathsPicture(
        columns,
        cloud,
        start[0],
        goal[0],
        ends=(problem.start, problem.goal),
        title=f"paths: {job.env} {problem.scenario.level} {problem.scenario.index}",
        projection=name,
    )
    paths_figure(picture, file)
    return {
        "projection": name,
        "min_log_density": float(limit) if np.isfinite(limit) else None,
        "plans": [_entry(*one) for one in zip(METHODS, plans, rejected, lines, strict=True)],
    }


def _column(
    method: str, plan: Explanation, rejected: list[int], xy: Points, pixels: Images
) -> PathPicture:
    """One path with its frames."""
    at = _shown(plan)
    caption, steps = _caption(method, plan.figures, rejected), [int(step) for step in at]
    return PathPicture(caption, xy, rejected, steps, pixels[plan.rows[at]])


def _entry(method: str, plan: Explanation, rejected: list[int], xy: Points) -> JsonDict:
    """The numbers of one path."""
    return {
        "method": method,
        "rejected": [*rejected],
        "rows": plan.rows.tolist(),
        "xy": [[float(x), float(y)] for x, y in xy],
        "plan": {key: plan.figures[key] for key in ("reached", "steps", "nodes", "path")},
    }


def rejected_steps(figures: JsonDict, limit: float) -> list[int]:
    """Steps of an explained plan whose edge ψ rejects: t is the edge from state t-1 to state t."""
    path: list[JsonDict] = figures["path"]  # type: ignore[assignment]  # as `explain_plan` has it
    edges: list[JsonDict] = [entry["edge"] for entry in path[1:]]  # type: ignore[misc]  # likewise
    return [t for t, edge in enumerate(edges, 1) if float(str(edge["log_density"])) < limit]


def _shown(plan: Explanation) -> Array:
    """Steps whose frames are drawn."""
    inner = np.arange(1, len(plan.path))
    return inner[:: max(1, -(-len(inner) // MOST_FRAMES))]


def _caption(method: str, figures: JsonDict, rejected: list[int]) -> str:
    reached = "goal reached" if figures["reached"] else "goal not reached"
    steps = f"{figures['steps']} steps, {reached}"
    edges = "1 edge" if len(rejected) == 1 else f"{len(rejected)} edges"
    return f"{method}\n{steps}; ψ rejects {edges}"
