"""CPC-CEM (Sec. 5.1) and two stronger samplers on φ's latents and h_f: iCEM and MPPI."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import ControlConfig, Controller
from elast_cli.control.followers import PlayActions
from elast_cli.envs.registry import task_info
from elast_cli.inference.rollout import CemRollout
from elast_cli.methods.loading import Models
from elast_cli.methods.replanning import replanning
from elast_cli.methods.thresholds import step_length
from elast_cli.models.encoder.cpc import Representation
from elast_cli.planners.cem import CemConfig, CemPlanner
from elast_cli.planners.icem import IcemConfig, IcemPlanner
from elast_cli.planners.mppi import MppiConfig, MppiPlanner
from elast_cli.planners.sampling import SamplingPlanner, SamplingPlannerConfig
from elast_cli.preset import Preset

_PLANNERS: dict[str, tuple[type[SamplingPlannerConfig], type[SamplingPlanner]]] = {
    "cem": (CemConfig, CemPlanner),
    "icem": (IcemConfig, IcemPlanner),
    "mppi": (MppiConfig, MppiPlanner),
}


def build(models: Models, preset: Preset, env: str, _rows: int) -> Controller[Any]:
    """CPC-CEM: plans of actions, played open loop until the next plan."""
    return _controller("cem", models, preset, env)


def build_icem(models: Models, preset: Preset, env: str, _rows: int) -> Controller[Any]:
    """The same by iCEM."""
    return _controller("icem", models, preset, env)


def build_mppi(models: Models, preset: Preset, env: str, _rows: int) -> Controller[Any]:
    """The same by MPPI."""
    return _controller("mppi", models, preset, env)


def _controller(section: str, models: Models, preset: Preset, env: str) -> Controller[Any]:
    planner = sampling_planner(section, models, preset, env)
    control = preset.section("control", ControlConfig)
    every = planner.config.replan_every
    return replanning(models, planner, PlayActions(), control, every=every)


def sampling_planner(section: str, models: Models, preset: Preset, env: str) -> SamplingPlanner:
    """A planner on trained models, which rolls out h_f.

    Args:
        section: of the preset, and name of the planner.
        models: with the encoder.
        preset: all configuration.
        env: name of the environment.
    """
    config_class, planner_class = _PLANNERS[section]
    config = preset.section(section, config_class)
    encoder = models.part("encoder", Representation)
    rollout = CemRollout(encoder.dynamics, task_info(env, preset.env).action_size)
    return planner_class(rollout, config, config.goal_steps * step_length(models, 0.5))
