"""The table of environments: names, entry points, and registration with gymnasium.

Nothing here imports an environment: its module loads when the first instance is made, and its
configuration class loads by itself, without the physics engine.

To add an environment, register one row: `register(EnvSpec(...))`. A package of yours makes its row
known to the `elast` command by an entry point in its pyproject.toml that names an `EnvSpec`:

    [project.entry-points."elast_cli.envs"]
    my-env = "my_package.row:SPEC"
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import Literal

import gymnasium
import pydantic

from elast_cli.config import StrictModel
from elast_cli.envs.base import DrawsScenarios, ElastEnv, TaskInfo
from elast_cli.envs.outside.names import PREFIX, is_id, is_outside, name_of
from elast_cli.envs.scenario import Scenario
from elast_cli.envs.simulated import SimulatedTask
from elast_cli.errors import ConfigError, UsageError, suggestion
from elast_cli.seeding import generator

GROUP = "elast_cli.envs"  # of entry points: rows that other packages add
Settings = StrictModel | Mapping[str, object]


@dataclass(frozen=True)
class EnvSpec:
    """One row of the table: what an environment's name stands for.

    Attributes:
        name: the word given to `--env`.
        entry_point: "module:Class" of the environment, an `ElastEnv`; called as `Class(config)`.
        config_entry_point: "module:Class" of its configuration, whose defaults are the task.
        about: one line for people.
        gym_id: its id in gymnasium's registry, None if it needs none.
        max_episode_steps: time limit of the gymnasium id: steps of the longest level.
    """

    name: str
    entry_point: str
    about: str
    config_entry_point: str = "elast_cli.config:StrictModel"
    gym_id: str | None = None
    max_episode_steps: int | None = None

    @property
    def config_class(self) -> type[StrictModel]:
        """Its configuration class."""
        found: type[StrictModel] = resolve_name(self.config_entry_point)
        return found

    def make(self, config: StrictModel) -> ElastEnv:
        """A new instance; its module loads with the first."""
        made: ElastEnv = resolve_name(self.entry_point)(config)
        return made


ENVS: dict[str, EnvSpec] = {}


def register(entry: EnvSpec) -> None:
    """Add an environment to the table and, if it has an id, to gymnasium's registry.

    Raises:
        UsageError: another environment has that name or that id, or may have it.
    """
    if entry.name in ENVS:
        if ENVS[entry.name] == entry:
            return
        raise UsageError(f"environment {entry.name!r} is already registered with other values")
    if is_outside(entry.name):
        raise UsageError(f"environment {entry.name!r}: names that begin with {PREFIX} are taken")
    if entry.gym_id in gymnasium.registry:
        raise UsageError(
            f"environment {entry.name!r}: gymnasium already has another {entry.gym_id}"
        )
    ENVS[entry.name] = entry
    if entry.gym_id:
        gymnasium.register(
            id=entry.gym_id,
            entry_point=entry.entry_point,
            max_episode_steps=entry.max_episode_steps,
        )


def _row(name: str, gym_name: str, where: str, steps: int, about: str) -> EnvSpec:
    """A row of elast's own, whose configuration stands in `config` of the same folder."""
    folder, class_name = where.split(".")[0], where.split(":")[1]
    return EnvSpec(
        name=name,
        entry_point=f"elast_cli.envs.{where}",
        about=about,
        config_entry_point=f"elast_cli.envs.{folder}.config:{class_name}Config",
        gym_id=f"elast/{gym_name}-v0",
        max_episode_steps=steps,
    )


for _entry in (
    _row("block-s", "BlockS", "block.static:Block", 74, "a block in an S-shaped corridor"),
    _row(
        "block-asym",
        "BlockAsym",
        "block.asym:BlockAsym",
        60,
        "a block in a ring whose one side is a one-way stream",
    ),
    _row(
        "block-param",
        "BlockParam",
        "block.param:BlockParam",
        44,
        "a block between walls whose places and gaps change with the episode",
    ),
    _row(
        "planar-arm",
        "PlanarArm",
        "planar_arm.arm:PlanarArm",
        64,
        "an arm of two links among obstacles that change with the episode",
    ),
    _row(
        "cable",
        "Cable",
        "cable.static:Cable",
        100,
        "a cable moved by one end between walls to a given shape",
    ),
    _row(
        "cable-param",
        "CableParam",
        "cable.param:CableParam",
        100,
        "a cable moved by one end between walls that change with the episode",
    ),
    _row("reach", "Reach", "sawyer.reach:Reach", 40, "a robot arm to a pose seen by a camera"),
    _row("button", "Button", "sawyer.button:Button", 60, "a robot arm that presses a button"),
    _row(
        "drawer", "Drawer", "sawyer.drawer:Drawer", 60, "a robot arm that opens or closes a drawer"
    ),
    _row("hammer", "Hammer", "sawyer.hammer:Hammer", 80, "a robot arm that drives a nail"),
):
    register(_entry)


@cache
def _load_entry_points() -> None:
    """Register the rows of other packages."""
    for point in entry_points(group=GROUP):
        register(point.load())


def names() -> list[str]:
    """All environments by name, those of other packages included."""
    _load_entry_points()
    return list(ENVS)


def spec(name: str) -> EnvSpec:
    """The environment of that name.

    Raises:
        UsageError: naming the choices and the closest of them.
    """
    if is_outside(name):
        return EnvSpec(
            name=name,
            entry_point="elast_cli.envs.outside.env:OutsideEnv",
            config_entry_point="elast_cli.envs.outside.config:OutsideConfig",
            about="an environment of another package, by its Gymnasium id",
        )
    if name not in ENVS:
        _load_entry_points()
    if name not in ENVS:
        hint = suggestion(name, [*ENVS, *gymnasium.registry])
        raise UsageError(
            f"unknown environment {name!r}{hint}; choose {', '.join(ENVS)}, or a Gymnasium id"
        )
    return ENVS[name]


def named(text: str) -> tuple[str, str | None]:
    """The environment's name that a text stands for, and its id if it is an outside one.

    A text is a name, one of our own Gymnasium ids, another Gymnasium id, or `module:Id`. Nothing is
    imported for it.

    Raises:
        UsageError: no environment is known by that text.
    """
    _load_entry_points()
    own = {entry.gym_id: name for name, entry in ENVS.items()}
    if text in ENVS or is_outside(text):
        return text, None
    if text in own:
        return own[text], None
    if is_id(text):
        return name_of(text), text
    return spec(text).name, None


def make(name: str, config: Settings | None = None) -> ElastEnv:
    """A new environment, without gymnasium's wrappers and without a time limit.

    Raises:
        UsageError: if no environment has that name.
        ConfigError: if the configuration does not fit it.
    """
    entry = spec(name)
    kind = entry.config_class
    if config is None:
        config = kind()
    elif isinstance(config, Mapping):
        try:
            config = kind.model_validate_json(json.dumps(dict(config)))
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ConfigError(f"configuration of {name}: {where}: {first['msg']}") from error
    elif not isinstance(config, kind):
        raise ConfigError(
            f"configuration of {name}: expected {kind.__name__}, not {type(config).__name__}"
        )
    return entry.make(config)


def make_simulated(name: str, config: Settings | None = None) -> SimulatedTask:
    """A new environment whose state can be set; see `make`.

    Raises:
        UsageError: if its state cannot be set.
    """
    env = make(name, config)
    if not isinstance(env, SimulatedTask):
        raise UsageError(f"{name}: its state cannot be set, so distances are unknown")
    return env


def task_info(name: str, config: Mapping[str, object] | None = None) -> TaskInfo:
    """What an environment says of itself; kept for the next caller.

    Raises:
        UsageError: if no environment has that name.
        ConfigError: if the configuration does not fit it.
    """
    return _task_info(name, None if config is None else json.dumps(config, sort_keys=True))


@cache
def _task_info(name: str, config: str | None) -> TaskInfo:
    with closing(make(name, None if config is None else json.loads(config))) as env:
        return env.task_info


def scenarios(
    env_name: str,
    level: str,
    *,
    seed: int,
    count: int,
    first: int = 0,
    domain: Literal["scenario-val", "scenario-test"] = "scenario-test",
    config: Settings | None = None,
) -> list[Scenario]:
    """Scenarios `first` to `first + count - 1` of a level.

    Scenario i depends on (domain, seed, level, i) alone.

    Raises:
        UsageError: if the environment or the level is unknown, or if it draws no scenarios.
    """
    with closing(make(env_name, config)) as env:
        key = zlib.crc32(env.task_info.level(level).name.encode())
        if not isinstance(env, DrawsScenarios):
            raise UsageError(f"{env_name} has no scenarios and can only be collected from")
        return [
            env.sample_scenario(level, generator(domain, seed, key, index), index=index, seed=seed)
            for index in range(first, first + count)
        ]
