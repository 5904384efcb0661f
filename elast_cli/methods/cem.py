"""CPC-CEM: the cross-entropy method on φ's latents and h_f (Sec. 5.1)."""

from __future__ import annotations

from typing import Any

from elast_cli.control.base import ControlConfig, Controller
from elast_cli.control.followers import PlayActions
from elast_cli.control.replan import Replan
from elast_cli.envs.registry import task_info
from elast_cli.inference.rollout import CemRollout
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import contexts, frame_encoder
from elast_cli.methods.thresholds import step_length
from elast_cli.models.encoder.cpc import Representation
from elast_cli.planners.cem import CemConfig, CemPlanner
from elast_cli.preset import Preset


def build(models: Models, preset: Preset, env: str, _rows: int) -> Controller[Any]:
    """The controller: plans of actions, played open loop until the next plan."""
    encoder = models.part("encoder", Representation)
    config, control = preset.section("cem", CemConfig), preset.section("control", ControlConfig)
    median = step_length(models, 0.5)
    rollout = CemRollout(encoder.dynamics, task_info(env, preset.env).action_size)
    return Replan(
        estimator=frame_encoder(models),
        contexts=contexts(models),
        planner=CemPlanner(rollout, config, config.goal_steps * median),
        follower=PlayActions(),
        every=config.replan_every,
        patience=control.patience,
        stall_distance=control.stall_steps * median,
    )
