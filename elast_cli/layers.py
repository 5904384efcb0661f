"""The layers of YAML and `--set` that make a preset, and its sections that data depend on.

Nothing here needs torch, which takes longer to import than a small dataset to collect.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field

import elast_cli
from elast_cli.config import StrictModel, parse_yaml, read_yaml, suggestion, validate
from elast_cli.envs.random_policy import RandomPolicyConfig
from elast_cli.envs.registry import spec
from elast_cli.errors import ConfigError, UsageError
from elast_cli.store.manifest import JsonDict

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


class DataSections(StrictModel):
    """The sections of a preset that a dataset depends on."""

    env: JsonDict = Field(
        default_factory=dict
    )  # of the environment's own config class, complete after `merged`
    collect: CollectConfig = CollectConfig()


Sections = TypeVar("Sections", bound=DataSections)


def shipped_data(name: str, env: str, overrides: Sequence[str] = ()) -> DataSections | None:
    """The data sections of a preset that elast came with, or None of any other.

    The other sections of such a preset are known to be right; those of a user's must be checked
    before anything is collected, which takes torch. `overrides` are of the data sections.
    """
    files = _files(name, env)
    if any(_shipped() not in path.resolve().parents for path in files):
        return None
    known = set(DataSections.model_fields)
    layers = [(read_yaml(path), str(path)) for path in files]
    ours = [({key: layer[key] for key in known & set(layer)}, where) for layer, where in layers]
    return _stacked(DataSections, ours, name, env, overrides)


def merged(model: type[Sections], name: str, env: str, overrides: Sequence[str] = ()) -> Sections:
    """Defaults, the preset's two YAML files, then `--set` overrides; see `preset.load`."""
    layers = [(read_yaml(path), str(path)) for path in _files(name, env)]
    return _stacked(model, layers, name, env, overrides)


def _stacked(
    model: type[Sections],
    layers: Sequence[tuple[Mapping[str, Any], str]],
    name: str,
    env: str,
    overrides: Sequence[str],
) -> Sections:
    """The layers one above the other, each of them checked; beside each is where it comes from."""
    config_class = spec(env).config_class
    stack: dict[str, Any] = model().model_dump(mode="json")
    for layer, where in [*layers, *([(_overrides(overrides), "--set")] if overrides else [])]:
        stack = _merge(stack, layer)
        validate(model, stack, where=where)
        validate(config_class, stack["env"], where=f"{where}: env")
    # the complete configuration goes into recipes, so that a later default can't change an old one
    stack["env"] = validate(config_class, stack["env"], where="env").model_dump(mode="json")
    return validate(model, stack, where=f"preset {name}")


def names() -> list[str]:
    """All presets that can be loaded here."""
    found = {path.parent.name for folder in folders() for path in folder.glob("*/_default.yaml")}
    return sorted(found)


def folders() -> Iterator[Path]:
    """Where presets are looked for, the first wins: here, $ELAST_HOME, what elast came with."""
    yield Path("configs")
    if home := os.environ.get("ELAST_HOME"):
        yield Path(home) / "configs"
    yield _shipped()


def _shipped() -> Path:
    """The folder of presets that elast came with."""
    package = Path(elast_cli.__file__).resolve().parent
    installed = package / "configs"  # in a wheel; beside the package in a checkout
    return installed if installed.is_dir() else package.parent / "configs"


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
