"""A world to search that needs no learning: a point in a walled box, with exact dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from elast_cli.planners.base import Query
from elast_cli.shapes import Bool, Float32, Float64, Int64

REACH = 0.15  # of one step along each axis
DOOR = 0.15  # half the width of the door in the wall
WIND = 0.03  # how far a context of 1 moves the point up in every step
IMPOSSIBLE = -100.0


def slopes_of(move: Callable[[Float32, Float32], Float32], z: Float32, a: Float32) -> Float32:
    """How the ends of moves [M,Z] change with z [M,Z] and a [M,A], by differences: [M,Z,Z+A]."""
    joint, size = np.concatenate([z, a], axis=1), z.shape[1]
    out = np.empty((len(z), size, joint.shape[1]), np.float32)
    for i in range(joint.shape[1]):
        by = np.zeros(joint.shape[1], np.float32)
        by[i] = 1e-2
        up, down = joint + by, joint - by
        out[:, :, i] = (
            move(up[:, :size], up[:, size:]) - move(down[:, :size], down[:, size:])
        ) / 0.02
    return out


@dataclass
class Box:
    """z in [-1, 1]²; z' = z + REACH·a + (stream, WIND·context). A wall at x = 0 has a door at
    y = context.

    ψ knows exactly which steps are possible. The variance is how far z' leaves the box along x,
    the distance to the support how far it leaves it along y. Where `stream` exceeds REACH nothing
    ever moves to the left.
    """

    stream: float = 0.0
    wall: bool = True
    context: Float32 = field(default_factory=lambda: np.zeros((1, 1), np.float32))
    latent_size: int = 2
    action_size: int = 2
    feature_size: int = 3
    members: int = 1
    axes: Float64 = field(default_factory=lambda: np.eye(2))

    def at(self, context: Float32) -> Box:
        return replace(self, context=context)

    def drift(self, context: Float32) -> Float32:
        """What a step adds by itself [M,2], in contexts [M]."""
        return np.stack([np.full_like(context, self.stream), np.float32(WIND) * context], axis=1)

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        z_next = z + np.float32(REACH) * action + self.drift(self.context[row, 0])
        return z_next, (np.abs(z_next[:, 0]) - 1).clip(0).astype(np.float32)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        return slopes_of(lambda z, a: self.step(z, a, np.full(len(z), row))[0], z, action)

    def features(self, z: Float32, row: Int64) -> Float32:
        return np.concatenate([z, self.context[row]], axis=1)

    def log_density(self, features: Float32, source: Int64, target: Int64) -> Float32:
        possible = self.possible(features[source, :2], features[target])
        return np.where(possible, 0, IMPOSSIBLE).astype(np.float32)

    def possible(self, z: Float32, to: Float32) -> Bool:
        """Whether one action leads from z [M,2] to `to` [M,3], its features, past the wall."""
        step = to[:, :2] - z - self.drift(to[:, 2])
        near: Bool = (np.abs(step) <= REACH + 1e-5).all(1)
        if not self.wall:
            return near
        x, x_next = z[:, 0].astype(np.float64), to[:, 0].astype(np.float64)
        crosses = (x < 0) != (x_next < 0)
        share = np.where(crosses, -x / np.where(crosses, x_next - x, 1), 0)
        height = z[:, 1] + share * (to[:, 1] - z[:, 1])
        free: Bool = near & (~crosses | (np.abs(height - to[:, 2]) <= DOOR))
        return free

    def support_distance(self, z: Float32) -> Float32:
        distance: Float32 = (np.abs(z[:, 1]) - 1).clip(0)
        return distance

    def supported(self, z: Float32, limit: float) -> Bool:
        near: Bool = self.support_distance(z) <= limit
        return near

    def act(self, z: Float32, z_next: Float32, row: Int64) -> Float32:
        step = z_next - z - self.drift(self.context[row, 0])
        return (step / np.float32(REACH)).clip(-1, 1)


def problems(rows: int, seed: int = 0) -> Query:
    """Random starts on the left, goals on the right, doors anywhere."""
    rng = np.random.default_rng(seed)
    left, right = rng.uniform(-0.9, 0.9, (2, rows, 2))
    left[:, 0], right[:, 0] = -0.5, 0.5
    return Query(
        start=left.astype(np.float32),
        goal=right.astype(np.float32),
        context=rng.uniform(-0.8, 0.8, (rows, 1)).astype(np.float32),
        seed=rng.integers(1 << 40, size=rows),
    )


def only(query: Query, row: int) -> Query:
    """One row of a query on its own."""
    return query.at(np.array([row]))
