"""Presets: every stage's configuration in one record; YAML and `--set` hold only what differs."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

import elast_cli
from elast_cli.config import StrictModel, parse_yaml, read_yaml, suggestion, validate
from elast_cli.context_training import ContextStage
from elast_cli.control import ControlConfig
from elast_cli.envs import RandomPolicyConfig, spec
from elast_cli.errors import ConfigError, UsageError
from elast_cli.manifest import JsonDict
from elast_cli.planners.cem import CemConfig
from elast_cli.planners.elast import TreeConfig
from elast_cli.training import DensityStage, EncoderStage, EnsembleStage, PolicyStage

DEFAULT = "standard"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}", re.ASCII)


class CollectConfig(StrictModel):
    """How much random interaction, and of what kind."""

    n: int = Field(default=50_000, gt=0, le=100_000_000, description="transitions")
    episode_steps: int = Field(default=50, gt=0, le=100_000)
    policy: RandomPolicyConfig = RandomPolicyConfig()

    @property
    def episodes(self) -> int:
        """Whole episodes that hold at least `n` transitions."""
        return -(-self.n // self.episode_steps)


class EvalConfig(StrictModel):
    """How a method is evaluated; scenario i is the same for every method."""

    episodes: int = Field(default=100, gt=0, le=100_000, description="a level")
    scenario_seed: int = Field(default=0, ge=0)
    domain: Literal["scenario-test", "scenario-val"] = "scenario-test"  # all tuning uses the latter
    num_envs: int = Field(default=10, gt=0, description="episodes that run side by side")


class Preset(StrictModel):
    """One configuration a stage; the defaults are the preset `standard`."""

    env: JsonDict = Field(
        default_factory=dict
    )  # of the environment's own config class, complete after `load`
    collect: CollectConfig = CollectConfig()
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
    config_class = spec(env).config_class
    merged: dict[str, Any] = Preset().model_dump(mode="json")
    layers: list[tuple[Mapping[str, Any], str]] = [
        (read_yaml(path), str(path)) for path in _files(name, env)
    ]
    if overrides:
        layers.append((_overrides(overrides), "--set"))
    for layer, where in layers:
        merged = _merge(merged, layer)
        validate(Preset, merged, where=where)
        validate(config_class, merged["env"], where=f"{where}: env")
    # the complete configuration goes into recipes, so that a later default can't change an old one
    merged["env"] = validate(config_class, merged["env"], where="env").model_dump(mode="json")
    return validate(Preset, merged, where=f"preset {name}")


def names() -> list[str]:
    """All presets that can be loaded here."""
    found = {path.parent.name for folder in folders() for path in folder.glob("*/_default.yaml")}
    return sorted(found)


def folders() -> Iterator[Path]:
    """Where presets are looked for, the first wins: here, $ELAST_HOME, what elast came with."""
    yield Path("configs")
    if home := os.environ.get("ELAST_HOME"):
        yield Path(home) / "configs"
    package = Path(elast_cli.__file__).resolve().parent
    installed = package / "configs"  # in a wheel; beside the package in a checkout
    yield installed if installed.is_dir() else package.parent / "configs"


def _files(name: str, env: str) -> list[Path]:
    """The preset's files, the more general first, each from the first folder that has it."""
    if not _NAME.fullmatch(name) or name not in names():
        choices = names()
        hint = suggestion(name, choices)
        raise UsageError(f"unknown preset {name!r}{hint}; choose {', '.join(choices)}")
    found = []
    for file in ("_default.yaml", f"{env}.yaml"):
        places = [folder / name / file for folder in folders()]
        found += [path for path in places if os.path.lexists(path)][:1]
    return found


def _overrides(texts: Sequence[str]) -> JsonDict:
    """All `section.key=value` texts as one nested mapping; values are read as YAML."""
    merged: JsonDict = {}
    for text in texts:
        path, equals, value = text.partition("=")
        keys = path.strip().split(".")
        if not equals or len(keys) < 2 or not all(keys):
            raise ConfigError(
                f"--set {text!r}: expected section.key=value, as in encoder.fit.steps=3000"
            )
        parsed = parse_yaml(f"value: {value}\n".encode(), f"--set {text}")
        if set(parsed) != {"value"}:
            raise ConfigError(f"--set {text!r}: the value is not one line of YAML")
        nested: Any = parsed["value"]
        for key in reversed(keys):
            nested = {key: nested}
        merged = _merge(merged, nested)
    return merged


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the leaves of `over` in place of its own."""
    merged = dict(base)
    for key, value in over.items():
        mine = merged.get(key)
        both = isinstance(value, Mapping) and isinstance(mine, Mapping)
        merged[key] = _merge(mine, value) if both else value  # type: ignore[arg-type]  # both are
    return merged
