"""Scripted controllers that know the whole state: they show that the tasks are possible."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elast_cli.envs.sawyer import drawer, hammer
from elast_cli.envs.sawyer.arm import SawyerTask
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.envs.scenario import Vector

Floats = NDArray[np.float64]
Oracle = Callable[[SawyerTask, Vector], Vector]

_CLOSE, _OPEN = 1.0, -1.0


def to(env: SawyerTask, place: ArrayLike, grip: float | None = None) -> Vector:
    """The action that moves the hand towards a place (x, y, z), m."""
    step = np.clip((np.asarray(place) - env.hand) / env.config.displacement, -1, 1)
    return np.array([*step] if grip is None else [*step, grip], dtype=np.float32)


def reach(env: SawyerTask, goal: Vector) -> Vector:
    """Straight to the goal."""
    return to(env, goal[:3])


def button(env: SawyerTask, goal: Vector) -> Vector:
    """Back from the button, over it if need be, before it, then into it."""
    x, y, z = env.hand
    before = 0.64
    if abs(x - goal[0]) < 0.02 and abs(z - goal[2]) < 0.02:
        return to(env, goal[:3])
    if y < before + 0.01:
        return to(env, [goal[0], before, goal[2]])
    if abs(x) < 0.1 and z < 0.2:  # beside or under the button, which is in the way
        return to(env, [x if abs(x) < 0.03 else np.sign(x) * 0.13, y, 0.24])
    return to(env, [x, before, z])


def opened(env: SawyerTask, goal: Vector) -> Vector:
    """Over the handle, down, so that it is between the fingers, then along."""
    x, y, z = env.hand
    missing = float(goal[-1]) - float(env.data.qpos[-1])  # to be pushed in, m
    at, height = drawer.HANDLE + float(env.data.qpos[-1]) + 0.005, 0.115
    if abs(missing) <= 0.006:
        return to(env, goal[:3])
    if abs(y - at) < 0.025 and z < height + 0.01:
        return to(env, [goal[0], y + missing, height])
    if abs(y - at) < 0.01 and abs(x - goal[0]) < 0.01:
        return to(env, [goal[0], at, height])
    return to(env, [x, y, 0.2] if z < 0.17 else [goal[0], at, max(0.19, z)])


class Hammering:
    """Over the handle, down, close, and with the hammer's head on the nail push it in."""

    def __init__(self) -> None:
        """Begin with an open hand."""
        self._stage, self._held = self.approach, 0

    def __call__(self, env: SawyerTask, goal: Vector) -> Vector:
        """The next action."""
        return self._stage(env, goal)

    def approach(self, env: SawyerTask, goal: Vector) -> Vector:
        """Above the handle, fingers open."""
        hand, grasp = env.hand, grasp_of(env)
        aside = np.hypot(*(hand - grasp)[:2])
        if aside < 0.006 and np.abs(env.data.qpos[7:9]).max() < 0.003:
            self._stage = self.descend
        if aside > 0.015 and hand[2] < 0.15:
            return to(env, [hand[0], hand[1], 0.18], _OPEN)
        return to(env, [grasp[0], grasp[1], 0.17], _OPEN)

    def descend(self, env: SawyerTask, goal: Vector) -> Vector:
        """Down to the handle."""
        if env.hand[2] < 0.065:
            self._stage, self._held = self.close, 0
        return to(env, [*grasp_of(env)[:2], 0.058], _OPEN)

    def close(self, env: SawyerTask, goal: Vector) -> Vector:
        """Close the fingers, and begin again if the handle is not between them."""
        self._held += 1
        if self._held > 4:
            holds = 0.015 < env.data.qpos[7] < 0.03 and abs(grasp_of(env)[1] - env.hand[1]) < 0.02
            self._stage = self.strike if holds else self.approach
        return to(env, env.hand, _CLOSE)

    def strike(self, env: SawyerTask, goal: Vector) -> Vector:
        """Bring the head before the nail, then push by what the nail still lacks."""
        hand, grasp = env.hand, grasp_of(env)
        if abs(grasp[1] - hand[1]) > 0.03 or hand[2] - grasp[2] > 0.06:  # it was lost
            self._stage = self.approach
            return to(env, hand, _OPEN)
        head = hammer.head_of(env.state)
        x, y, z = hammer.head_of(goal) - head
        if abs(x) > 0.012 or abs(z) > 0.012:
            away = min(0.0, 0.53 - head[1])
            return to(env, hand + ([0, away, z] if abs(z) > 0.012 else [x, away, z]), _CLOSE)
        nail = float(env.data.qpos[hammer.NAIL])
        push = y if nail < 0.001 else goal[-1] - nail
        return to(env, hand + np.array([x, push, z]), _CLOSE)


def grasp_of(env: SawyerTask) -> Floats:
    """Where the hammer's handle is best held (x, y, z), m."""
    pose = env.data.qpos[hammer.HAMMER]
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array([0.07, 0.0, 0.0]), pose[3:].copy())
    place: Floats = pose[:3] + turned
    return place


def of(name: str) -> Oracle:
    """A new oracle of a task."""
    oracles: dict[str, Oracle] = {"reach": reach, "button": button, "drawer": opened}
    return oracles.get(name) or Hammering()
