"""PlaNet (Hafner et al. 2019) towards a goal image: CEM on its recurrent state-space model."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import Controller
from elast_cli.control.followers import PlayActions
from elast_cli.control.replan import Replan
from elast_cli.inference.rssm import BeliefFilter, BeliefRollout
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import no_contexts
from elast_cli.models.rssm.net import Rssm
from elast_cli.planners.cem import CemPlanner, PlanetConfig
from elast_cli.preset import Preset


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The controller: beliefs filtered at each step, distances to the goal by s alone."""
    config, model = preset.section("planet", PlanetConfig), models.part("rssm", Rssm)
    planner = CemPlanner(
        rollout=BeliefRollout(model),
        config=config,
        goal_radius=config.goal_steps * model.step_length_quantiles.at(0.5),
        measured=model.config.stochastic,
    )
    return Replan(
        estimator=BeliefFilter(model),
        contexts=no_contexts,
        planner=planner,
        follower=PlayActions(),
        every=config.replan_every,
    )
