"""The settings of an outside environment that are null: measured once, then in every recipe."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from itertools import combinations

import numpy as np

from elast_cli.config import JsonDict, validate
from elast_cli.envs.outside.config import INFO, RANDOM, OutsideConfig
from elast_cli.envs.outside.loading import load_hook, version_of
from elast_cli.envs.outside.success import Numbers, apart, compared
from elast_cli.envs.outside.world import World
from elast_cli.errors import ConfigError, UsageError
from elast_cli.seeding import generator

EPISODES, STEPS, EVERY = 10, 50, 10  # of the calibration: two states in a row of every ten
CHANCE = 0.1  # of a success in an episode of unrelated states


def complete(config: OutsideConfig) -> OutsideConfig:
    """A configuration without null settings; itself if nothing is missing.

    Raises:
        UsageError: the environment lacks what elast needs, or a seed does not repeat an episode.
        ConfigError: its version is another one, or settings do not go together.
    """
    needs_radius = config.success in ("image", "state") and config.success_radius is None
    if needs_radius or None in (config.version, config.goal, config.success):
        return _completed(config.model_dump_json())
    return config


def checked_version(config: OutsideConfig) -> OutsideConfig:
    """The configuration complete, its version that of what is installed.

    Raises:
        ConfigError: the configuration has another version.
    """
    found = complete(config.model_copy(update={"version": None}))
    if config.version not in (None, found.version):
        raise ConfigError(
            f"{config.id}: env.version is {config.version!r}, installed is {found.version!r}; "
            "install that version, or leave the key out"
        )
    return found


@cache
def _completed(text: str) -> OutsideConfig:
    """The same for a configuration as JSON; measured once in a process."""
    config = OutsideConfig.model_validate_json(text)
    with contextlib.closing(World(config)) as world:
        _expect_repeatable(world)
        world.config = _changed(config, _kind(world))
        hook, radius = world.config.hook, world.config.success_radius
        sources = [type(world.inner.unwrapped), *([load_hook(hook)] if hook else [])]
        if world.config.success in ("image", "state") and radius is None:
            radius = _calibrated(world)
    return _changed(world.config, {"version": version_of(*sources), "success_radius": radius})


def _changed(config: OutsideConfig, values: JsonDict) -> OutsideConfig:
    """The configuration with some values, checked again."""
    data = {**config.model_dump(mode="json"), **values}
    return validate(OutsideConfig, data, where=config.id, at="env")


def _kind(world: World) -> JsonDict:
    """Where goals come from, and what decides success, for what is null."""
    world.reset(0)
    config, image = world.config, world.info.get("goal")
    own = isinstance(image, np.ndarray) and image.ndim == 3
    goal = config.goal or (INFO if own else RANDOM)
    if config.success is not None or goal == RANDOM:
        return {"goal": goal, "success": config.success or "image"}
    world.step(np.zeros(world.action_size, np.float32))
    return {"goal": goal, "success": "image" if world.reported_success() is None else "info"}


def _expect_repeatable(world: World) -> None:
    """Raise UsageError unless the same seed and actions give the same frames and states."""

    def episode(seed: int) -> Iterator[bytes]:
        for _ in world.rollout(seed, generator("settings", seed), 3):
            yield world.frame().tobytes() + world.state.tobytes()

    if [*episode(1)] != [*episode(1)]:
        raise UsageError(
            f"{world.config.id}: reset(seed=1) and the same actions give other frames or states "
            "the second time; all of its randomness has to come from self.np_random"
        )


def _calibrated(world: World) -> float:
    """The distance up to which a state counts as the goal, to four digits.

    It is the median distance of one random step, or less: so little that a walk through unrelated
    states, as many as an episode has steps, comes that close with probability `CHANCE`. Pairs of
    states of different episodes stand for unrelated ones; those that do not differ are left out.

    Raises:
        UsageError: random actions change nothing.
    """
    steps: list[float] = []
    samples: list[tuple[int, Numbers]] = []
    for episode in range(EPISODES):
        rng = generator("settings", 0, episode)
        last = None
        for count in world.rollout(int(rng.integers(2**31)), rng, STEPS):
            if (count - 1) % EVERY > 1:
                last = None
                continue
            seen = compared(world)
            if last is not None:
                steps.append(apart(world.config.success, seen, last))
            samples.append((episode, seen))
            last = seen
    pairs = [
        apart(world.config.success, a, b)
        for (one, a), (other, b) in combinations(samples, 2)
        if one != other
    ]
    moved, differing = ([d for d in some if d > 0] for some in (steps, pairs))
    if not (moved and differing):
        raise UsageError(
            f"{world.config.id}: too little changes under random actions to say what success is; "
            "set env.success_radius, or another env.success"
        )
    unrelated = np.quantile(differing, CHANCE / world.config.max_steps)
    return float(f"{min(float(np.median(moved)), float(unrelated)):.4g}")
