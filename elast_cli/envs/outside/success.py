"""What success compares: two images, or two states, as vectors with a distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elast_cli.envs.outside.config import OutsideConfig
from elast_cli.envs.outside.pixels import coarse
from elast_cli.envs.outside.world import World
from elast_cli.envs.scenario import Frame
from elast_cli.errors import ConfigError

Numbers = NDArray[np.float64]
UNITS = {"image": "RMS of 16x16 averages", "state": "units of the state"}


def compared(world: World) -> Numbers:
    """What success compares of the current state, by `config.success`: image or state.

    Raises:
        ConfigError: `state_dims` names a number that the state lacks.
    """
    if world.config.success == "image":
        return of_frame(world.frame())
    state, dims = world.state.astype(np.float64), list(world.config.state_dims)
    if dims and not all(0 <= dim < len(state) for dim in dims):
        names = ", ".join(world.named_state())
        raise ConfigError(f"env.state_dims={dims}: the state has {len(state)} numbers: {names}")
    return state[dims] if dims else state


def of_frame(frame: Frame) -> Numbers:
    """What is compared of a frame u8 [64, 64, 3]."""
    return coarse(frame).ravel()


def apart(success: str | None, a: Numbers, b: Numbers) -> float:
    """Distance of what is compared: root mean square of images, Euclidean of states."""
    squares = np.square(a - b)
    return float(np.sqrt(squares.mean() if success == "image" else squares.sum()))


def description(config: OutsideConfig) -> str:
    """What decides success, for people."""
    if config.success == "image":
        return f"image within {config.success_radius:g} of the goal's ({UNITS['image']})"
    if config.success == "state":
        dims = f" {list(config.state_dims)}" if config.state_dims else ""
        what = f"{config.state or 'observation'}{dims}"
        return f"{what} within {config.success_radius:g} of the goal's"
    if config.success == "info":
        return "as the environment reports it in info"
    return "the environment terminates the episode"
