"""Optimisers of whole paths on φ's latents and h_f: collocation (Sec. 5.1) and gradients."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import ControlConfig, Controller
from elast_cli.control.followers import PlayActions
from elast_cli.inference.forward_dynamics import ForwardDynamics
from elast_cli.methods.loading import Models
from elast_cli.methods.replanning import replanning
from elast_cli.methods.thresholds import median_step
from elast_cli.models.tensors import under
from elast_cli.planners.base import DynamicsOf
from elast_cli.planners.collocation import CollocationConfig, CollocationPlanner
from elast_cli.planners.gradient import GradientConfig, GradientPlanner
from elast_cli.planners.lifted import LiftedPlanner
from elast_cli.preset import Preset


def build_collocation(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """CPC-Coll: plans of actions, played open loop until the next plan."""
    config = preset.section("collocation", CollocationConfig)
    planner = CollocationPlanner(forward_dynamics(models), config, median_step(models))
    return _controller(planner, models, preset)


def build_gradient(models: Models, preset: Preset, _env: str, _rows: int) -> Controller[Any]:
    """The same by Adam."""
    config = preset.section("gradient", GradientConfig)
    planner = GradientPlanner(forward_dynamics(models), config, median_step(models))
    return _controller(planner, models, preset)


def forward_dynamics(models: Models) -> DynamicsOf:
    """h_f of the encoder."""
    encoder = models.stored("encoder")
    arrays = under(encoder.arrays, "dynamics.net")
    return ForwardDynamics(arrays, encoder.spec.sizes.action, models.device).at


def _controller(planner: LiftedPlanner, models: Models, preset: Preset) -> Controller[Any]:
    control = preset.section("control", ControlConfig)
    every = planner.config.replan_every
    return replanning(models, planner, PlayActions(), control, every=every)
