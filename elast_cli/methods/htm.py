"""HTM: shortest paths between hallucinated images, followed by an inverse model (Sec. 5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from elast_cli.control.base import Controller, Task
from elast_cli.control.followers import PaceStates
from elast_cli.control.replan import Replan
from elast_cli.inference.hallucination import Hallucination
from elast_cli.methods.loading import Models
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.htm.net import Htm
from elast_cli.planners.base import PlanCost, Query
from elast_cli.planners.hallucination.config import HallucinationConfig
from elast_cli.planners.hallucination.search import HallucinationPlanner, weights_along
from elast_cli.preset import Preset
from elast_cli.shapes import FRAMES, Float64, Uint8

SECTION = "hallucination"


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The controller: it plans on images, and its inverse model aims at them in turn."""
    seen, planner = parts(models, preset)
    config = planner.config
    return Replan(
        estimator=seen,
        contexts=seen.contexts,
        planner=planner,
        follower=PaceStates(seen.act, config.waypoint_steps),
        every=config.replan_every,
    )


def parts(models: Models, preset: Preset) -> tuple[Hallucination, HallucinationPlanner]:
    """What the method sees and generates, and its planner."""
    seen = Hallucination(models.part("cvae", Cvae), models.part("htm", Htm))
    config = preset.section(SECTION, HallucinationConfig)
    return seen, HallucinationPlanner(seen, config)


@dataclass(frozen=True)
class ImagePlan:
    """A plan, for people.

    Attributes:
        images: of its nodes u8 [T,S,S,3], from that of the start to that of the goal.
        weights: of the edges between them [T-1]; 1 is the least.
    """

    images: Uint8
    weights: Float64


def planned_images(
    models: Models,
    preset: Preset,
    frame: Uint8,
    goal: Uint8,
    *,
    context: Uint8 | None = None,
    seed: int = 0,
) -> ImagePlan:
    """The images that a plan leads through.

    Args:
        models: with `cvae` and `htm`.
        preset: configuration of the planner.
        frame: of the start, u8 [64,64,3].
        goal: of the goal, u8 [64,64,3].
        context: the context image u8 [64,64,3], where the task has one.
        seed: of the generated images.
    """
    seen, planner = parts(models, preset)
    resting, frames = (np.repeat(x[None, None], FRAMES, axis=1) for x in (goal, frame))
    shown = None if context is None else context[None]
    target, state = seen.begin(Task(resting, np.array([seed]), shown))
    start, _ = seen.update(state, frames, None)
    query = Query(start, target, seen.contexts(shown, 1), np.array([seed]))
    cost = PlanCost.zero(1)
    graph = planner.graph(query, 0, cost)
    path = planner.route(graph, query, 0, cost).nodes
    images = seen.pictures(query.context[0], seed, planner.config.samples)[path]
    return ImagePlan(images, weights_along(graph, path))
