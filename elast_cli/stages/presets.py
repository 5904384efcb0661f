"""The sections of all presets: the environment's, the stages', the parts' and the methods'."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from elast_cli import preset
from elast_cli.config import StrictModel
from elast_cli.control.collection import CollectConfig
from elast_cli.envs.outside.config import OutsideConfig
from elast_cli.envs.outside.names import is_outside
from elast_cli.envs.registry import spec
from elast_cli.methods.table import METHODS
from elast_cli.models.parts import PARTS, imported
from elast_cli.preset import ENV, Preset
from elast_cli.stages.trust import refuse_untrusted


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
    *,
    trusted: bool = False,
) -> Preset:
    """The preset `name` for an environment; see `preset.load`.

    The settings of an outside environment are completed, which runs it.

    Raises:
        UntrustedError: a file names outside code; not if `trusted`.
    """
    found = preset.load(name, env, sections(env), overrides, flags)
    if not is_outside(env):
        return found
    refuse_untrusted(found.env, [*overrides, *(text for _, text in flags)], trusted=trusted)
    from elast_cli.envs.outside.settings import checked_version

    complete = checked_version(found.section(ENV, OutsideConfig)).model_dump(mode="json")
    return found.changed({ENV: complete}, by=str(complete["id"]))
