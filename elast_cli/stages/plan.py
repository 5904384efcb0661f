"""`elast plan`: one problem planned and explained, as JSON and as a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.errors import MissingInputError, UsageError
from elast_cli.methods.table import Method, method_named, needing
from elast_cli.models.parts import DATASET
from elast_cli.shapes import IMAGE_SIZE, Int64, Uint8
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.job import (
    PLANNER,
    Job,
    RecipeJob,
    note_if_unrepeatable,
)
from elast_cli.stages.posed import Posed, posed
from elast_cli.stages.problem import Problem
from elast_cli.stages.resolve import resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

if TYPE_CHECKING:
    from elast_cli.methods.explain import Explanation

ALGORITHM_VERSION = 11
PLAN_FILE = "plan.json"
PICTURE_FILE = "plan.png"
METRICS = ("reached", "steps", "nodes", "seconds", "repeatable")
MOST_FRAMES = 38  # along the path, in the picture


def recipe_job(job: Job, method: str, problem: Problem) -> RecipeJob:
    """The plan of one method for one problem.

    Raises:
        UsageError: a method that grows no tree.
        MissingInputError: a model is not made yet.
    """
    entry = _tree_method(method)
    inputs = _inputs(job.of_method(entry), entry)
    config: JsonDict = {
        "method": method,
        "sections": entry.settings(job.config),
        "env": job.config.env,
        **problem.config,
    }
    recipe = job.recipe("plan", config, inputs, algorithm_version=ALGORITHM_VERSION)
    return RecipeJob(job, recipe, inputs, lambda run: _plan(job, entry, problem, inputs, run))


def _inputs(job: Job, method: Method) -> dict[str, Ref]:
    """The parts of a method, and the data, whose frames a picture shows, if they are here."""
    try:
        return resolve(job, (DATASET, *method.parts))
    except MissingInputError:
        if DATASET in job.given:
            raise
        return resolve(job, method.parts)


def document(store: Store, ref: Ref) -> JsonDict:
    """What `elast plan --json` prints."""
    found: JsonDict = json.loads(store.file(ref, PLAN_FILE).read_bytes())
    return {"ref": str(ref), "path": str(store.path(ref)), **found}


def _tree_method(name: str) -> Method:
    entry = method_named(name)
    if PLANNER not in entry.sections:
        choices = ", ".join(needing(PLANNER))
        raise UsageError(f"--method {name}: this method grows no tree; choose {choices}")
    return entry


def remark(store: Store, ref: Ref) -> str:
    """Whether a plan reaches its goal, and if not, why: one line for people."""
    plan: Any = document(store, ref)["plan"]
    return str(plan["outcome"]["text"])


def _plan(
    job: Job, method: Method, problem: Problem, inputs: Mapping[str, Ref], run: Run
) -> JsonDict:
    from elast_cli.methods.explain import explain_plan
    from elast_cli.planners.tree.config import TreeConfig

    note_if_unrepeatable(job, method)
    seen = posed(job, inputs, problem)
    config = method.configure(job.config).section(PLANNER, TreeConfig)
    plan = explain_plan(seen.models, config, seen.query, seen.views.distance)
    data: JsonDict = {"method": method.name, **seen.described, "plan": plan.figures}
    with (run.staging / PLAN_FILE).open("x", encoding="utf-8") as file:
        json.dump(data, file, indent=1, allow_nan=False)
    _draw(job, inputs, seen, plan, run)
    return {key: plan.figures[key] for key in METRICS}


def _draw(job: Job, inputs: Mapping[str, Ref], seen: Posed, plan: Explanation, run: Run) -> None:
    """The tree and the path in the plane, beside the nearest data frames along the path."""
    from elast_cli.pictures.plan import PlanPicture, plan_figure
    from elast_cli.pictures.projection import project_parts

    support, query = seen.support, seen.query
    every = [plan.latents, plan.path, support, query.start, query.goal]
    (nodes, path, cloud, start, goal), name = project_parts(every, fit=support, seed=job.seed)
    inner = np.arange(1, len(plan.path) if DATASET in inputs else 1)
    shown = inner[:: max(1, -(-len(inner) // MOST_FRAMES))]
    picture = PlanPicture(
        nodes_xy=nodes,
        parents=plan.parents,
        path_xy=path,
        start_xy=start[0],
        goal_xy=goal[0],
        support_xy=cloud,
        frames=_frames(job, inputs, plan.rows[shown]),
        path_steps=[int(at) for at in shown],
        start=seen.views.start[-1],
        goal=seen.views.goal[-1],
        title=f"{run.recipe.config['method']}: {job.env} {seen.title}",
        lines=_captions(plan.figures),
        projection=name,
    )
    plan_figure(picture, run.staging / PICTURE_FILE)


def _frames(job: Job, inputs: Mapping[str, Ref], rows: Int64) -> Uint8:
    """Frames of the data [M,64,64,3], checked chunk by chunk as they are read."""
    from elast_cli.data.dataset import Dataset

    if DATASET not in inputs:
        job.progress.note(
            "the data are not here, so the picture has no frames along the path; "
            f"run: elast collect {job.flags()}"
        )
        return np.zeros((0, IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    return Dataset.load(job.store.path(inputs[DATASET]) / DATASET_FILE).pixels[rows]


def _captions(figures: JsonDict) -> tuple[str, str]:
    """The outcome of a plan, in two lines."""
    ended: Any = figures["outcome"]
    reached = "reached" if figures["reached"] else f"not reached: {ended['reason']}"
    return (
        f"{figures['steps']} steps, goal {reached}",
        f"{figures['nodes']} nodes in {figures['seconds']:.1f} s",
    )
