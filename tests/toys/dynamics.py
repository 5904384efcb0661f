"""Dynamics with exact slopes, to optimise whole paths on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from elast_cli.planners.base import Query
from elast_cli.shapes import Float32, Int64

REACH = 0.15  # of one step along each axis
SPEED, TURN = 0.1, 0.5  # of a unicycle: how far, and by how many rad, one step goes at most


@dataclass
class Toy:
    """What both toys have: contexts [B,C], one network, no variance."""

    context: Float32 = field(default_factory=lambda: np.zeros((1, 2), np.float32))
    members: int = 3

    def at(self, context: Float32) -> Self:
        return replace(self, context=context)


@dataclass
class PointMass(Toy):
    """z' = z + REACH·a + c on the plane."""

    latent_size: int = 2
    action_size: int = 2

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        z_next = z + np.float32(REACH) * action + self.context[row]
        return z_next, np.zeros(len(z), np.float32)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        both = np.concatenate([np.eye(2), REACH * np.eye(2)], axis=1)
        return np.repeat(both[None], len(z), axis=0).astype(np.float32)


@dataclass
class Exploding(PointMass):
    """Whatever is done, the next state overflows."""

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        return np.full_like(z, np.inf), np.zeros(len(z), np.float32)


@dataclass
class Unicycle(Toy):
    """z = (x, y, heading); an action goes forward or back and turns. Nothing goes sideways."""

    latent_size: int = 3
    action_size: int = 2

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        ahead, heading = np.float32(SPEED) * action[:, 0], z[:, 2]
        move = [ahead * np.cos(heading), ahead * np.sin(heading), np.float32(TURN) * action[:, 1]]
        return z + np.stack(move, axis=1), np.zeros(len(z), np.float32)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        out = np.zeros((len(z), 3, 5), np.float32)
        out[:, :, :3] = np.eye(3)
        cos, sin, ahead = np.cos(z[:, 2]), np.sin(z[:, 2]), SPEED * action[:, 0]
        out[:, 0, 2], out[:, 1, 2] = -ahead * sin, ahead * cos
        out[:, 0, 3], out[:, 1, 3], out[:, 2, 4] = SPEED * cos, SPEED * sin, TURN
        return out


def array(values: Any) -> Float32:
    """Nested numbers as an array."""
    return np.array(values, np.float32)


def query(rows: int = 3, size: int = 2) -> Query:
    """Random starts and goals about the origin, in different contexts."""
    rng = np.random.default_rng(0)
    return Query(
        start=rng.uniform(-0.5, 0.5, (rows, size)).astype(np.float32),
        goal=rng.uniform(-0.5, 0.5, (rows, size)).astype(np.float32),
        context=rng.uniform(-0.03, 0.03, (rows, 2)).astype(np.float32),
        seed=rng.integers(1 << 40, size=rows),
    )
