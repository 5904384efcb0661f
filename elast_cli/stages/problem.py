"""What `elast plan` plans: a scenario of a task, or images that a user gives."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.config import JsonDict
from elast_cli.envs.base import ElastEnv
from elast_cli.envs.registry import make, scenarios
from elast_cli.envs.scenario import Scenario
from elast_cli.envs.simulated import SimulatedTask
from elast_cli.errors import UsageError
from elast_cli.seeding import derived_seed
from elast_cli.shapes import FRAMES, Uint8
from elast_cli.stages.evaluate import plan_seed
from elast_cli.stages.job import Job
from elast_cli.stages.presets import EvalConfig

if TYPE_CHECKING:
    from elast_cli.methods.explain import Distance


@dataclass(frozen=True)
class Views:
    """Start and goal of a problem as a method sees them.

    Attributes:
        start, goal: stacks of frames u8 [F,64,64,3].
        context: its image u8 [64,64,3], where the task has one.
        seed: of the plan.
        described: what is known of the problem, for JSON.
        distance: of two true states, where the environment knows it.
    """

    start: Uint8
    goal: Uint8
    context: Uint8 | None
    seed: int
    described: JsonDict
    distance: Distance | None = None


@dataclass(frozen=True)
class Problem:
    """One planning problem, which is seen only when it is planned.

    Attributes:
        config: what determines it, for the recipe.
        title: for its picture.
        views: its start and goal.
    """

    config: JsonDict
    title: str
    views: Callable[[], Views]


def of_scenario(job: Job, level: str, index: int) -> Problem:
    """A scenario of the job's task: the first plan that its evaluation would make.

    Raises:
        UsageError: unknown level.
    """
    settings = job.config.section("eval", EvalConfig)
    config: JsonDict = {
        "level": level,
        "max_steps": job.task_info.level(level).max_steps,
        "scenario": index,
        "scenario_seed": settings.scenario_seed,
        "domain": settings.domain,
    }
    return Problem(config, f"{level} {index}", lambda: _seen_in(job, level, index))


def _seen_in(job: Job, level: str, index: int) -> Views:
    """The frames of a scenario."""
    scenario = _scenario(job, level, index)
    env = make(job.env, job.config.env)
    start, info = env.reset(options={"scenario": scenario})
    return Views(
        start=stacked([start]),
        goal=stacked([info["goal"]]),
        context=info.get("context"),
        seed=derived_seed("plan", plan_seed(job, scenario), 0),
        described=_described(scenario),
        distance=_distance_of(env),
    )


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


def _distance_of(env: ElastEnv) -> Distance | None:
    """How far two true states are apart, where the environment knows it."""
    return env.distance if isinstance(env, SimulatedTask) else None


def _described(scenario: Scenario) -> JsonDict:
    return {
        "level": scenario.level,
        "scenario": scenario.index,
        "scenario_seed": scenario.seed,
        "start": [float(x) for x in scenario.start],
        "goal": [float(x) for x in scenario.goal],
        "shortest": scenario.shortest,
    }


def of_images(
    job: Job, start: Sequence[str], goal: Sequence[str], context: str | None = None
) -> Problem:
    """Images in files as start and goal.

    Args:
        job: names the task.
        start: one to three files, the oldest first; one is a start at rest.
        goal: likewise.
        context: the context image, where the task has one.

    Raises:
        UsageError: too few or too many images.
        MissingInputError: there is no such file.
        DataError: a file is no image that can be used.
    """
    from elast_cli.data.image_files import read_image

    for flag, paths in (("--start", start), ("--goal", goal)):
        if not 1 <= len(paths) <= FRAMES:
            raise UsageError(f"{flag}: give 1 to {FRAMES} images, got {len(paths)}")
    if job.task_info.has_context != (context is not None):
        word = "needs" if context is None else "has no"
        raise UsageError(f"--context-image: {job.env} {word} context image")
    begin, end = (stacked([read_image(path) for path in paths]) for paths in (start, goal))
    seen = None if context is None else read_image(context)
    images: JsonDict = {"start": _digest(begin), "goal": _digest(end)}
    if seen is not None:
        images["context"] = _digest(seen)
    files: JsonDict = {"start": list(start), "goal": list(goal)}
    views = Views(begin, end, seen, derived_seed("plan", job.seed, 0), {"images": files})
    title = f"{Path(start[-1]).name} to {Path(goal[-1]).name}"
    return Problem({"images": images}, title, lambda: views)


def stacked(frames: Sequence[Uint8]) -> Uint8:
    """The last F of some frames as a stack [F,64,64,3]; the first one repeats."""
    return np.stack([*[frames[0]] * (FRAMES - len(frames)), *frames])[-FRAMES:]


def _digest(frames: Uint8) -> str:
    """SHA-256 of frames, whatever the files that they came from."""
    return hashlib.sha256(frames.tobytes()).hexdigest()
