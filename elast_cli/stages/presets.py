"""The sections of all presets: the environment's, the stages', the parts' and the methods'."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from elast_cli import preset
from elast_cli.config import StrictModel
from elast_cli.control.collection import CollectConfig
from elast_cli.envs.registry import spec
from elast_cli.methods.table import METHODS
from elast_cli.models.parts import PARTS, imported
from elast_cli.preset import Preset


class EvalConfig(StrictModel):
    """How a method is evaluated; scenario i is the same for every method."""

    episodes: int = Field(default=100, gt=0, le=100_000, description="scenarios of a level")
    scenario_seed: int = Field(default=0, ge=0, description="seed of the scenarios")
    domain: Literal["scenario-test", "scenario-val"] = Field(
        default="scenario-test", description="use scenario-val for tuning"
    )
    num_envs: int = Field(default=10, gt=0, description="episodes that run side by side")


def sections(env: str) -> dict[str, type[StrictModel]]:
    """The class that parses each section, for an environment."""
    found: dict[str, type[StrictModel]] = {"env": spec(env).config_class, "collect": CollectConfig}
    found |= {kind: part.section for kind, part in PARTS.items()}
    for method in METHODS.values():
        found |= {name: imported(of) for name, of in method.sections.items()}
    return {**found, "eval": EvalConfig}


def load(
    name: str,
    env: str,
    overrides: Sequence[str] = (),
    flags: Sequence[tuple[str, str]] = (),
) -> Preset:
    """The preset `name` for an environment; see `preset.load`."""
    return preset.load(name, env, sections(env), overrides, flags)
