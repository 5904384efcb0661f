"""Presets: every stage's configuration in one record; YAML and `--set` hold only what differs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from elast_cli.config import StrictModel
from elast_cli.control.base import ControlConfig
from elast_cli.layers import DataSections, merged
from elast_cli.models.context.training import ContextStage
from elast_cli.models.density.training import DensityStage
from elast_cli.models.encoder.training import EncoderStage
from elast_cli.models.ensemble.training import EnsembleStage
from elast_cli.models.policy.training import PolicyStage
from elast_cli.planners.cem import CemConfig
from elast_cli.planners.tree.search import TreeConfig


class EvalConfig(StrictModel):
    """How a method is evaluated; scenario i is the same for every method."""

    episodes: int = Field(default=100, gt=0, le=100_000, description="a level")
    scenario_seed: int = Field(default=0, ge=0)
    domain: Literal["scenario-test", "scenario-val"] = "scenario-test"  # all tuning uses the latter
    num_envs: int = Field(default=10, gt=0, description="episodes that run side by side")


class Preset(DataSections):
    """One configuration a stage; the defaults are the preset `standard`."""

    context: ContextStage = ContextStage()
    encoder: EncoderStage = EncoderStage()
    ensemble: EnsembleStage = EnsembleStage()
    density: DensityStage = DensityStage()
    policy: PolicyStage = PolicyStage()
    planner: TreeConfig = TreeConfig()
    control: ControlConfig = ControlConfig()
    cem: CemConfig = CemConfig()
    eval: EvalConfig = EvalConfig()


def load(name: str, env: str, overrides: Sequence[str] = ()) -> Preset:
    """The preset `name` for an environment: defaults, its two YAML files, then `--set` overrides.

    Args:
        name: a folder of `configs/`.
        env: the environment's name; `<name>/<env>.yaml` is read where there is one.
        overrides: texts of the form section.key=value.

    Raises:
        UsageError: unknown preset or environment.
        ConfigError: a bad key or value; names the file or `--set`, the field and what is allowed.
    """
    return merged(Preset, name, env, overrides)
