"""k-NN graph: shortest paths on a map of the training states, followed by π as ELAST's are."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import ControlConfig, Controller
from elast_cli.methods.loading import Models
from elast_cli.methods.replanning import latent_world, replanning, tracking
from elast_cli.methods.thresholds import limits, radii, step_length
from elast_cli.planners.graph.config import GraphSearchConfig
from elast_cli.planners.graph.roadmap import Roadmap, roadmap
from elast_cli.planners.graph.search import GraphPlanner
from elast_cli.planners.tree.config import ReuseConfig, RewireConfig, TreeConfig
from elast_cli.preset import Preset

NEIGHBOR = "graph_search.neighbor_quantile"


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The controller: like ELAST's, with a map in place of trees."""
    config = preset.section("graph_search", GraphSearchConfig)
    control = preset.section("control", ControlConfig)
    as_tree = _as_tree(config)
    planner = GraphPlanner(
        world=latent_world(models).at,
        roadmap=map_of(models, config),
        limits=limits(models, as_tree),
        radii=radii(models, as_tree, NEIGHBOR),
        edge_tests=config.edge_tests,
    )
    every = control.replan_every
    return replanning(models, planner, tracking(models, control), control, every=every)


def map_of(models: Models, config: GraphSearchConfig) -> Roadmap:
    """The map of the graph's states, joined within r_neigh."""
    arrays = models.stored("graph").arrays
    return roadmap(
        arrays["latents"],
        arrays["rows"],
        spacing=config.spacing_steps * step_length(models, 0.5),
        radius=radii(models, _as_tree(config), NEIGHBOR).neighbor,
    )


def _as_tree(config: GraphSearchConfig) -> TreeConfig:
    """The tree search with the same thresholds and radii, less the support test."""
    return TreeConfig(
        goal_steps=config.goal_steps,
        tests=config.tests.model_copy(update={"support_quantile": None}),
        rewire=RewireConfig(neighbor_quantile=config.neighbor_quantile),
        reuse=ReuseConfig(failure_steps=config.failure_steps),
    )
