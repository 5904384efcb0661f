"""ELAST: trees through latent space, refined by shooting, followed by MPC (Sec. 4.3, 4.4)."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import ControlConfig, Controller
from elast_cli.control.followers import PlayActions
from elast_cli.methods.loading import Models
from elast_cli.methods.replanning import latent_world, replanning, tracking
from elast_cli.methods.thresholds import limits, radii, step_length
from elast_cli.models.tensors import under
from elast_cli.planners.refined_tree import ShootingPlanner
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.preset import Preset


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The controller of ELAST and of its variants."""
    control = preset.section("control", ControlConfig)
    plans = planner(models, preset.section("planner", TreeConfig))
    follower = PlayActions() if control.follow == "actions" else tracking(models, control)
    return replanning(models, plans, follower, control, every=control.replan_every)


def planner(models: Models, config: TreeConfig) -> ElastPlanner | ShootingPlanner:
    """The planner on trained models, with its thresholds from their calibration.

    It grows trees, and where the configuration has it refines their paths by shooting.
    """
    trees = tree_planner(models, config)
    median = step_length(models, 0.5)
    if not config.refine.iterations:
        return trees
    goal, kept = config.refine.goal_steps * median, config.refine.kept_steps * median
    return ShootingPlanner(trees, median, goal, kept)


def tree_planner(models: Models, config: TreeConfig) -> ElastPlanner:
    """The part of the planner that grows trees."""
    forward_model = under(models.stored("encoder").arrays, "dynamics.net")
    world = latent_world(models, None if config.use_ensemble else forward_model)
    return ElastPlanner(world.at, config, limits(models, config), radii(models, config))
