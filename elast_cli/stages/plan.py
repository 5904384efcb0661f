"""`elast plan`: one scenario planned and explained, as JSON and as a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.envs.base import ElastEnv
from elast_cli.envs.registry import make, scenarios
from elast_cli.envs.scenario import Scenario
from elast_cli.envs.simulated import SimulatedTask
from elast_cli.errors import UsageError
from elast_cli.methods.table import Method, method_named, needing
from elast_cli.models.parts import DATASET, PARTS
from elast_cli.seeding import derived_seed
from elast_cli.shapes import FRAMES, Uint8
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.evaluate import plan_seed
from elast_cli.stages.job import (
    PLANNER,
    Job,
    RecipeJob,
    note_if_unrepeatable,
    verify_files,
)
from elast_cli.stages.presets import EvalConfig
from elast_cli.stages.resolve import resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

if TYPE_CHECKING:
    from elast_cli.methods.explain import Distance, Explanation

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
    max_steps = job.task_info.level(level).max_steps
    inputs = resolve(job.of_method(entry), (DATASET, *entry.parts))
    settings = job.config.section("eval", EvalConfig)
    config: JsonDict = {
        "method": method,
        "sections": entry.settings(job.config),
        "env": job.config.env,
        "level": level,
        "max_steps": max_steps,
        "scenario": index,
        "scenario_seed": settings.scenario_seed,
        "domain": settings.domain,
    }
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
    from elast_cli.control.base import Task
    from elast_cli.control.episodes import context_images
    from elast_cli.methods.explain import explain_plan
    from elast_cli.methods.loading import Models
    from elast_cli.methods.sight import contexts, frame_encoder
    from elast_cli.planners.base import Query
    from elast_cli.planners.tree.config import TreeConfig

    note_if_unrepeatable(job, method)
    verify_files(job.store, {role: ref for role, ref in inputs.items() if role != DATASET})
    folders = {role: job.store.path(ref) for role, ref in inputs.items() if role in PARTS}
    models = Models(folders, job.device, job.threads)
    scenario = _scenario(job, level, index)
    env = make(job.env, job.config.env)
    start, info = env.reset(options={"scenario": scenario})
    seed = np.array([derived_seed("plan", plan_seed(job, scenario), 0)])
    task = Task(_resting(info["goal"]), seed, context_images([info]))
    encoder, read = frame_encoder(models), contexts(models)
    goal, state = encoder.begin(task)
    latent, _ = encoder.update(state, _resting(start), None)
    query = Query(latent, goal, read(task.context, 1), seed)
    config = method.configure(job.config).section(PLANNER, TreeConfig)
    plan = explain_plan(models, config, query, _distance_of(env))
    data: JsonDict = {"method": method.name, **_described(job, scenario), "plan": plan.figures}
    with (run.staging / PLAN_FILE).open("x", encoding="utf-8") as file:
        json.dump(data, file, indent=1, allow_nan=False)
    support = models.stored("ensemble").arrays["support.latents"]
    ends = np.concatenate([query.start, query.goal])
    _draw(job, inputs, plan, support=support, ends=ends, frames=(start, info["goal"]), run=run)
    return {key: plan.figures[key] for key in METRICS}


def _distance_of(env: ElastEnv) -> Distance | None:
    """How far two true states are apart, where the environment knows it."""
    return env.distance if isinstance(env, SimulatedTask) else None


def _scenario(job: Job, level: str, index: int) -> Scenario:
    settings = job.config.section("eval", EvalConfig)
    return scenarios(
        job.env,
        level,
        seed=settings.scenario_seed,
        count=1,
        first=index,
        domain=settings.domain,
        config=job.config.env,
    )[0]


def _resting(frame: Uint8) -> Uint8:
    """A frame as the stack of a world at rest [1,F,64,64,3]."""
    return np.repeat(frame[None, None], FRAMES, axis=1)


def _described(job: Job, scenario: Scenario) -> JsonDict:
    return {
        "env": job.env,
        "level": scenario.level,
        "scenario": scenario.index,
        "scenario_seed": scenario.seed,
        "train_seed": job.seed,
        "start": [float(x) for x in scenario.start],
        "goal": [float(x) for x in scenario.goal],
        "shortest": scenario.shortest,
    }


def _draw(
    job: Job,
    inputs: Mapping[str, Ref],
    plan: Explanation,
    *,
    support: Any,
    ends: Any,
    frames: tuple[Uint8, Uint8],
    run: Run,
) -> None:
    """The tree and the path in the plane, beside the nearest data frames along the path."""
    from elast_cli.data.dataset import Dataset
    from elast_cli.pictures.plan import PlanPicture, plan_figure
    from elast_cli.pictures.projection import project_2d

    # frames are checked chunk by chunk as they are read: the rest of the file does not matter here
    pixels = Dataset.load(job.store.path(inputs[DATASET]) / DATASET_FILE).pixels
    every = [plan.latents, plan.path, support, ends]
    places, name = project_2d(np.concatenate(every), fit=support, seed=job.seed)
    nodes, path, cloud, both = np.split(places, np.cumsum([len(part) for part in every[:-1]]))
    inner = np.arange(1, len(plan.path))
    shown = inner[:: max(1, -(-len(inner) // MOST_FRAMES))]
    config = run.recipe.config
    picture = PlanPicture(
        nodes_xy=nodes,
        parents=plan.parents,
        path_xy=path,
        start_xy=both[0],
        goal_xy=both[1],
        support_xy=cloud,
        frames=pixels[plan.rows[shown]],
        path_steps=[int(at) for at in shown],
        start=frames[0],
        goal=frames[1],
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
