"""Collisions of the arm's links with obstacles, and motion past them; angles in rad."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elast_cli.compiled import njit

Floats = NDArray[np.float64]


@njit()
def collides(
    first: float, second: float, lengths: Floats, radius: float, obstacles: Floats
) -> bool:
    """Whether the second link meets an obstacle [M, 3]; none is in reach of the first.

    The base is the middle of the workspace.

    Args:
        first: angle of the first link against the x axis, rad.
        second: angle of the second link against the first, rad.
        lengths: of the links f64 [2], in workspace widths.
        radius: of the links, in workspace widths.
        obstacles: centre and radius (x, y, r) f64 [M, 3], in workspace widths.
    """
    ax = 0.5 + lengths[0] * np.cos(first)
    ay = 0.5 + lengths[0] * np.sin(first)
    ux = lengths[1] * np.cos(first + second)
    uy = lengths[1] * np.sin(first + second)
    for i in range(obstacles.shape[0]):
        px, py = obstacles[i, 0] - ax, obstacles[i, 1] - ay
        part = min(max((px * ux + py * uy) / (ux * ux + uy * uy), 0.0), 1.0)
        if np.hypot(px - part * ux, py - part * uy) < radius + obstacles[i, 2]:
            return True
    return False


@njit()
def turned(
    angles: Floats,
    turn: Floats,
    parts: int,
    limit: float,
    lengths: Floats,
    radius: float,
    obstacles: Floats,
) -> Floats:
    """Angles [2] after so many equal turns [2], each by both joints, by one, or not at all.

    Args:
        angles: f64 [2], rad.
        turn: of each part f64 [2], rad.
        parts: number of equal turns.
        limit: greatest absolute angle, rad.
        lengths: of the links f64 [2], in workspace widths.
        radius: of the links, in workspace widths.
        obstacles: centre and radius (x, y, r) f64 [M, 3], in workspace widths.

    Returns:
        f64 [2], rad.
    """
    first, second = angles[0], angles[1]
    for _ in range(parts):
        both = min(max(first + turn[0], -limit), limit), min(max(second + turn[1], -limit), limit)
        if not collides(both[0], both[1], lengths, radius, obstacles):
            first, second = both
        elif not collides(both[0], second, lengths, radius, obstacles):
            first = both[0]
        elif not collides(first, both[1], lengths, radius, obstacles):
            second = both[1]
    return np.array([first, second])


@njit()
def free_cells(
    axis: Floats, lengths: Floats, radius: float, obstacles: Floats
) -> NDArray[np.uint8]:
    """Which cells of joint space are free: u8 [n, n], the second joint by rows.

    Args:
        axis: angles of the cells f64 [n], rad, the same for both joints.
        lengths: of the links f64 [2], in workspace widths.
        radius: of the links, in workspace widths.
        obstacles: centre and radius (x, y, r) f64 [M, 3], in workspace widths.
    """
    free = np.zeros((axis.size, axis.size), dtype=np.uint8)
    for row in range(axis.size):
        for column in range(axis.size):
            free[row, column] = not collides(axis[column], axis[row], lengths, radius, obstacles)
    return free
