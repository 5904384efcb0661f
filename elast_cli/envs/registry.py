"""The environments by name, their scenarios, and their registration with gymnasium."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import gymnasium
import pydantic

from elast_cli.config import StrictModel
from elast_cli.envs.base import ElastEnv
from elast_cli.envs.block import (
    Block,
    BlockAsym,
    BlockAsymConfig,
    BlockConfig,
    BlockParam,
    BlockParamConfig,
)
from elast_cli.envs.cable import Cable, CableConfig, CableParam, CableParamConfig
from elast_cli.envs.planar_arm import PlanarArm, PlanarArmConfig
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.envs.scenario import Level, Scenario
from elast_cli.errors import ConfigError, UsageError, suggestion
from elast_cli.seeding import generator

__all__ = [
    "ENVS",
    "ElastEnv",
    "EnvSpec",
    "Level",
    "RandomPolicy",
    "RandomPolicyConfig",
    "Scenario",
    "make",
    "scenarios",
    "spec",
]


@dataclass(frozen=True)
class EnvSpec:
    """One environment: what its name stands for.

    Attributes:
        name: the word given to `--env`.
        gym_id: its id in gymnasium's registry.
        env_class: called as `env_class(config)`.
        config_class: its configuration; the defaults are the task.
        about: one line for people.
        unit: unit of `success_radius` and `ElastEnv.distance`.
    """

    name: str
    gym_id: str
    env_class: type[ElastEnv]
    config_class: type[StrictModel]
    about: str
    unit: str

    @property
    def levels(self) -> dict[str, Level]:
        """Levels by name, the easiest first."""
        return self.env_class.levels

    @property
    def action_size(self) -> int:
        """Size A of an action."""
        return self.env_class.action_size

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the S numbers of a true state."""
        return self.env_class.state_names

    @property
    def max_steps(self) -> int:
        """Steps of the longest level: the time limit of the gymnasium id."""
        return max(level.max_steps for level in self.levels.values())


ENVS: dict[str, EnvSpec] = {
    entry.name: entry
    for entry in (
        EnvSpec(
            name="block-s",
            gym_id="elast/BlockS-v0",
            env_class=Block,
            config_class=BlockConfig,
            about="a block in an S-shaped corridor",
            unit="workspace widths",
        ),
        EnvSpec(
            name="block-asym",
            gym_id="elast/BlockAsym-v0",
            env_class=BlockAsym,
            config_class=BlockAsymConfig,
            about="a block in a ring whose one side is a one-way stream",
            unit="workspace widths",
        ),
        EnvSpec(
            name="block-param",
            gym_id="elast/BlockParam-v0",
            env_class=BlockParam,
            config_class=BlockParamConfig,
            about="a block between walls whose places and gaps change with the episode",
            unit="workspace widths",
        ),
        EnvSpec(
            name="planar-arm",
            gym_id="elast/PlanarArm-v0",
            env_class=PlanarArm,
            config_class=PlanarArmConfig,
            about="an arm of two links among obstacles that change with the episode",
            unit="workspace widths",
        ),
        EnvSpec(
            name="cable",
            gym_id="elast/Cable-v0",
            env_class=Cable,
            config_class=CableConfig,
            about="a cable moved by one end between walls to a given shape",
            unit="workspace widths",
        ),
        EnvSpec(
            name="cable-param",
            gym_id="elast/CableParam-v0",
            env_class=CableParam,
            config_class=CableParamConfig,
            about="a cable moved by one end between walls that change with the episode",
            unit="workspace widths",
        ),
    )
}

for _entry in ENVS.values():
    gymnasium.register(
        id=_entry.gym_id,
        entry_point=f"{_entry.env_class.__module__}:{_entry.env_class.__name__}",
        max_episode_steps=_entry.max_steps,
    )


def spec(name: str) -> EnvSpec:
    """The environment of that name.

    Raises:
        UsageError: naming the choices and the closest of them.
    """
    if name not in ENVS:
        hint = suggestion(name, ENVS)
        raise UsageError(f"unknown environment {name!r}{hint}; choose {', '.join(ENVS)}")
    return ENVS[name]


def make(name: str, config: StrictModel | Mapping[str, object] | None = None) -> ElastEnv:
    """A new environment, without gymnasium's wrappers and without a time limit.

    Raises:
        UsageError: if no environment has that name.
        ConfigError: if the configuration does not fit it.
    """
    entry = spec(name)
    if config is None:
        config = entry.config_class()
    elif isinstance(config, Mapping):
        try:
            config = entry.config_class.model_validate_json(json.dumps(dict(config)))
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ConfigError(f"configuration of {name}: {where}: {first['msg']}") from error
    elif not isinstance(config, entry.config_class):
        raise ConfigError(
            f"configuration of {name}: expected {entry.config_class.__name__}, "
            f"not {type(config).__name__}"
        )
    return entry.env_class(config)


def scenarios(
    env_name: str,
    level: str,
    *,
    seed: int,
    count: int,
    first: int = 0,
    domain: Literal["scenario-val", "scenario-test"] = "scenario-test",
    config: StrictModel | Mapping[str, object] | None = None,
) -> list[Scenario]:
    """Scenarios `first` to `first + count - 1` of a level.

    Scenario i depends on (domain, seed, level, i) alone.

    Raises:
        UsageError: if the environment or the level is unknown.
    """
    env = make(env_name, config)
    key = zlib.crc32(env.level(level).name.encode())
    return [
        env.sample_scenario(level, generator(domain, seed, key, index), index=index, seed=seed)
        for index in range(first, first + count)
    ]
