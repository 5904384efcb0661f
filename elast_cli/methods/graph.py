"""k-NN graph: shortest paths on a map of the training states, followed by π as ELAST's are."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import ControlConfig, Controller
from elast_cli.control.followers import TrackStates
from elast_cli.control.replan import Replan
from elast_cli.inference.latent_world import LatentWorld, PolicyCall
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import contexts, frame_encoder
from elast_cli.methods.thresholds import limits, radii, step_length
from elast_cli.planners.graph.config import GraphSearchConfig
from elast_cli.planners.graph.roadmap import Roadmap, roadmap
from elast_cli.planners.graph.search import GraphPlanner
from elast_cli.planners.tree.config import ReuseConfig, RewireConfig, TreeConfig
from elast_cli.preset import Preset


def build(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The controller: like ELAST's, with a map in place of trees."""
    config = preset.section("graph_search", GraphSearchConfig)
    control = preset.section("control", ControlConfig)
    world = LatentWorld(
        ensemble=models.stored("ensemble"),
        density=models.stored("density"),
        policy=models.stored("policy"),
        device=models.device,
    )
    as_tree = _as_tree(config)
    planner = GraphPlanner(
        world=world.at,
        roadmap=map_of(models, config),
        limits=limits(models, as_tree),
        radii=radii(models, as_tree),
        edge_tests=config.edge_tests,
    )
    return Replan(
        estimator=frame_encoder(models),
        contexts=contexts(models),
        planner=planner,
        follower=TrackStates(PolicyCall(models.stored("policy"), models.device), control.lookahead),
        every=control.replan_every,
        patience=control.patience,
        stall_distance=control.stall_steps * step_length(models, 0.5),
    )


def map_of(models: Models, config: GraphSearchConfig) -> Roadmap:
    """The map of the graph's states, joined within r_neigh."""
    arrays = models.stored("graph").arrays
    return roadmap(
        arrays["latents"],
        arrays["rows"],
        spacing=config.spacing_steps * step_length(models, 0.5),
        radius=radii(models, _as_tree(config)).neighbor,
    )


def _as_tree(config: GraphSearchConfig) -> TreeConfig:
    """The tree search with the same thresholds and radii."""
    return TreeConfig(
        goal_steps=config.goal_steps,
        tests=config.tests,
        rewire=RewireConfig(neighbor_quantile=config.neighbor_quantile),
        reuse=ReuseConfig(failure_steps=config.failure_steps),
    )
