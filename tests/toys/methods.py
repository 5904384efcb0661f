"""Untrained models that methods are built of, and presets with small searches."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn

from elast_cli.config import JsonDict
from elast_cli.envs.registry import task_info
from elast_cli.models.density.config import DensityConfig
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.encoder.config import CpcConfig, EncoderConfig
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.ensemble.config import EnsembleConfig
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.files import save_model
from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.goal_policy.gcidm.config import GcidmConfig
from elast_cli.models.goal_policy.net import GoalPolicy
from elast_cli.models.goal_policy.pixel_gcbc.config import PixelGcbcConfig
from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy
from elast_cli.models.graph.net import TrainingStates
from elast_cli.models.nets import QuantileTable
from elast_cli.models.part import Sizes
from elast_cli.models.policy.config import PolicyConfig
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.models.rssm.net import Rssm
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.preset import Preset
from tests.toys.models import SMALL_RSSM, hallucination, trained

ROWS, LATENT, STATE = 2, 3, 2
TINY = [
    "planner.expansions=40",
    "cem.num_samples=8",
    "cem.topk=4",
    "cem.n_steps=2",
    "cem.horizon=5",
    "collocation.iterations=3",
    "gradient.iterations=3",
    "planet.num_samples=8",
    "planet.topk=4",
    "planet.n_steps=2",
    "planet.horizon=5",
    "hallucination.samples=20",
]


def tree_config(preset: Preset, changes: JsonDict | None = None) -> TreeConfig:
    """The search of a preset, with some changes."""
    changed = preset.changed({"planner": changes}, by="test") if changes else preset
    return changed.section("planner", TreeConfig)


def ramp(quantiles: QuantileTable, top: float) -> None:
    """A table whose quantile p is p times `top`."""
    quantiles.fit(torch.linspace(0, top, 1001, dtype=torch.float64))


def save_tiny(folder: Path, env: str) -> dict[str, Path]:
    """Untrained models for an environment, a folder for each kind."""
    torch.manual_seed(0)
    action = task_info(env).action_size
    encoder = Representation(
        EncoderConfig(latent_size=LATENT, width=8, pool=8), CpcConfig(dynamics_width=8), action, 0
    )
    ensemble = SupportedDynamics(
        EnsembleConfig(members=2, width=8, support_size=100),
        latent_size=LATENT,
        action_size=action,
        context_size=0,
        state_size=STATE,
    )
    density = TransitionDensity(DensityConfig(width=8), LATENT, 0)
    policy = LocalPolicy(PolicyConfig(width=8), LATENT, action, 0)
    graph = TrainingStates(60, LATENT)
    graph.latents.normal_()
    graph.rows.copy_(torch.arange(60))
    ramp(encoder.step_length_quantiles, 1.0)
    ramp(ensemble.ensemble.variance_quantiles, 10.0)
    ramp(ensemble.support.distance_quantiles, 20.0)
    ramp(density.log_density_quantiles, -30.0)
    ramp(policy.round_trip_quantiles, 40.0)
    sizes = Sizes(latent=LATENT, action=action, context=0, state=STATE)
    parts: dict[str, nn.Module] = {
        "encoder": encoder,
        "ensemble": ensemble,
        "density": density,
        "policy": policy,
        "graph": graph,
    }
    small = GoalNetConfig(width=8, depth=1)
    parts |= {kind: GoalPolicy(small, sizes, 0) for kind in ("gcbc", "gciql")}
    parts["gcidm"] = GoalPolicy(GcidmConfig(width=8, depth=1), sizes, 1)
    pixels = PixelGcbcConfig(width=8, depth=1, pool=4, channels=4)
    parts["rssm"] = Rssm(SMALL_RSSM, action)
    parts["pixel_gcbc"] = PixelGoalPolicy(pixels, action, 0)
    parts |= hallucination(action, has_context=False)
    for kind, module in parts.items():
        (folder / kind).mkdir()
        save_model(folder / kind, trained(module, sizes))
    return {kind: folder / kind for kind in parts}
