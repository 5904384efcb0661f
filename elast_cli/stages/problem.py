"""One scenario as the problem that a planner sees: frames, latents, trained models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.envs.base import ElastEnv
from elast_cli.envs.registry import make, scenarios
from elast_cli.envs.scenario import Scenario
from elast_cli.envs.simulated import SimulatedTask
from elast_cli.models.parts import DATASET, PARTS
from elast_cli.seeding import derived_seed
from elast_cli.shapes import FRAMES, Uint8
from elast_cli.stages.evaluate import plan_seed
from elast_cli.stages.job import Job, verify_files
from elast_cli.stages.presets import EvalConfig
from elast_cli.store.manifest import Ref

if TYPE_CHECKING:
    from elast_cli.methods.explain import Distance
    from elast_cli.methods.loading import Models
    from elast_cli.models.tensors import Array
    from elast_cli.planners.base import Query


@dataclass(frozen=True)
class Problem:
    """One scenario, as an episode begins.

    Attributes:
        scenario: with the true states.
        env: where it takes place, reset to it.
        models: the trained parts.
        query: the first that the controller would put to its planner, of one row.
        start, goal: frames [64,64,3].
    """

    scenario: Scenario
    env: ElastEnv
    models: Models
    query: Query
    start: Uint8
    goal: Uint8

    @property
    def distance(self) -> Distance | None:
        """How far two true states are apart, where the environment knows it."""
        return self.env.distance if isinstance(self.env, SimulatedTask) else None

    @property
    def support(self) -> Array:
        """Latents of encoded training states [N,Z]."""
        return self.models.stored("ensemble").arrays["support.latents"]


def posed(job: Job, inputs: Mapping[str, Ref], level: str, index: int) -> Problem:
    """A scenario, and its first query by trained parts whose files are checked.

    Args:
        job: the lineage.
        inputs: the parts, by kind.
        level: of the scenario.
        index: its number.

    Raises:
        DataError: a part is damaged.
    """
    from elast_cli.control.base import Task
    from elast_cli.control.episodes import context_images
    from elast_cli.methods.loading import Models
    from elast_cli.methods.sight import contexts, frame_encoder
    from elast_cli.planners.base import Query

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
    return Problem(scenario, env, models, query, start, info["goal"])


def settings_of(job: Job, level: str, index: int) -> JsonDict:
    """What a recipe says of a scenario. Raises UsageError: an unknown level."""
    max_steps = job.task_info.level(level).max_steps
    settings = job.config.section("eval", EvalConfig)
    return {
        "env": job.config.env,
        "level": level,
        "max_steps": max_steps,
        "scenario": index,
        "scenario_seed": settings.scenario_seed,
        "domain": settings.domain,
    }


def described(job: Job, scenario: Scenario) -> JsonDict:
    """A scenario as plain data."""
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
