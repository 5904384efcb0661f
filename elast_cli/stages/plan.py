"""`elast plan`: one scenario planned and explained, as JSON and as a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.errors import UsageError
from elast_cli.methods.table import Method, method_named, needing
from elast_cli.models.parts import DATASET
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.job import PLANNER, Job, RecipeJob, note_if_unrepeatable
from elast_cli.stages.problem import Problem, described, posed, settings_of
from elast_cli.stages.resolve import resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

if TYPE_CHECKING:
    from elast_cli.methods.explain import Explanation

ALGORITHM_VERSION = 10
PLAN_FILE = "plan.json"
PICTURE_FILE = "plan.png"
METRICS = ("reached", "steps", "nodes", "seconds", "repeatable")
MOST_FRAMES = 38  # along the path, in the picture


def recipe_job(job: Job, method: str, level: str, index: int) -> RecipeJob:
    """The plan of one method for one scenario: the first that its evaluation would make.

    Raises:
        UsageError: unknown level, or a method that grows no tree.
        MissingInputError: a model is not made yet.
    """
    entry = _tree_method(method)
    where = settings_of(job, level, index)
    inputs = resolve(job.of_method(entry), (DATASET, *entry.parts))
    config: JsonDict = {"method": method, "sections": entry.settings(job.config), **where}
    recipe = job.recipe("plan", config, inputs, algorithm_version=ALGORITHM_VERSION)
    return RecipeJob(job, recipe, inputs, lambda run: _plan(job, entry, level, index, inputs, run))


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


def _plan(
    job: Job, method: Method, level: str, index: int, inputs: Mapping[str, Ref], run: Run
) -> JsonDict:
    from elast_cli.methods.explain import explain_plan
    from elast_cli.planners.tree.config import TreeConfig

    note_if_unrepeatable(job, method)
    problem = posed(job, inputs, level, index)
    config = method.configure(job.config).section(PLANNER, TreeConfig)
    plan = explain_plan(problem.models, config, problem.query, problem.distance)
    where = described(job, problem.scenario)
    data: JsonDict = {"method": method.name, **where, "plan": plan.figures}
    with (run.staging / PLAN_FILE).open("x", encoding="utf-8") as file:
        json.dump(data, file, indent=1, allow_nan=False)
    _draw(job, inputs, problem, plan, run)
    return {key: plan.figures[key] for key in METRICS}


def _draw(
    job: Job, inputs: Mapping[str, Ref], problem: Problem, plan: Explanation, run: Run
) -> None:
    """The tree and the path in the plane, beside the nearest data frames along the path."""
    from elast_cli.data.dataset import Dataset
    from elast_cli.pictures.plan import PlanPicture, plan_figure
    from elast_cli.pictures.projection import project_parts

    # frames are checked chunk by chunk as they are read: the rest of the file does not matter here
    pixels = Dataset.load(job.store.path(inputs[DATASET]) / DATASET_FILE).pixels
    support, query = problem.support, problem.query
    every = [plan.latents, plan.path, support, query.start, query.goal]
    (nodes, path, cloud, start, goal), name = project_parts(every, fit=support, seed=job.seed)
    inner = np.arange(1, len(plan.path))
    shown = inner[:: max(1, -(-len(inner) // MOST_FRAMES))]
    config = run.recipe.config
    picture = PlanPicture(
        nodes_xy=nodes,
        parents=plan.parents,
        path_xy=path,
        start_xy=start[0],
        goal_xy=goal[0],
        support_xy=cloud,
        frames=pixels[plan.rows[shown]],
        path_steps=[int(at) for at in shown],
        start=problem.start,
        goal=problem.goal,
        title=f"{config['method']}: {job.env} {config['level']} {config['scenario']}",
        lines=_captions(plan.figures),
        projection=name,
    )
    plan_figure(picture, run.staging / PICTURE_FILE)


def _captions(figures: JsonDict) -> tuple[str, str]:
    """The outcome of a plan, in two lines."""
    reached = "reached" if figures["reached"] else "not reached"
    return (
        f"{figures['steps']} steps, goal {reached}",
        f"{figures['nodes']} nodes in {figures['seconds']:.1f} s",
    )
