"""Least number of steps between places of a rectangle world, under the true action bound.

The centre of a block moves over a lattice that is aligned with every wall. One step is any
displacement within an L-infinity ball, made at constant velocity; where a wall blocks one axis, the
other goes on (sliding), round the wall's corner too. Walls and step lengths are whole numbers of
cells, so endpoints need rounding to the lattice only where a corner is rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from elast_cli.errors import ConfigError

Rect = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max
Floats = NDArray[np.float64]
UNREACHABLE = -1


class Lattice:
    """All one-step moves of a point in [low, high]^2 minus open rectangles; made once per layout.

    `into[y, x, dy, dx]` (u8) says whether one step leads from cell (x - dx, y - dy) to cell (x, y);
    dx and dy count from -reach. A field, i16 [ny, nx], holds every cell's steps to a goal region.
    """

    def __init__(
        self, walls: Sequence[Rect], *, low: float, high: float, step: float, cell: float
    ) -> None:
        """Compute every move; `walls` as the point meets them, all lengths multiples of `cell`.

        Raises:
            ConfigError: if a length is not a multiple of the cell.
        """
        self.low, self.cell = low, cell
        self.size = _cells(high - low, cell) + 1
        self.reach = _cells(step, cell)
        corners = [[_cells(side - low, cell) for side in wall] for wall in walls]
        self.walls = np.array(corners, dtype=np.float64).reshape(-1, 4)
        self.into: NDArray[np.uint8] = _moves(self.walls, self.size, self.reach)

    def field(self, goal: NDArray[np.floating], radius: float) -> NDArray[np.int16]:
        """Steps from every cell to the disc of `radius` round a goal [2]: i16 [ny, nx], or -1."""
        axis = self.low + self.cell * np.arange(self.size)
        disc = np.hypot(axis[None, :] - goal[0], axis[:, None] - goal[1]) <= radius + 1e-9
        inside: NDArray[np.uint8] = disc.astype(np.uint8)
        steps: NDArray[np.int16] = _flood(self.into, inside & _free_cells(self.walls, self.size))
        return steps

    def steps(self, field: NDArray[np.int16], place: NDArray[np.floating]) -> int:
        """Steps from a place [2]: the least of the cells round it, -1 if none reaches the goal."""
        spot = (np.asarray(place, dtype=np.float64) - self.low) / self.cell
        first = np.clip(np.floor(spot + 1e-4).astype(int), 0, self.size - 1)
        last = np.clip(np.ceil(spot - 1e-4).astype(int), 0, self.size - 1)
        near = field[first[1] : last[1] + 1, first[0] : last[0] + 1]
        reached = near[near != UNREACHABLE]
        return int(reached.min()) if reached.size else UNREACHABLE

    def after(self, place: NDArray[np.floating], actions: NDArray[np.floating]) -> Floats:
        """Where each action f [M, 2] in [-1, 1] leads from one place [2], sliding: f64 [M, 2]."""
        spot = self._outside((np.asarray(place, dtype=np.float64) - self.low) / self.cell)
        moves = np.asarray(actions, dtype=np.float64) * self.reach
        last = self.size - 1.0
        ends = [_slide(spot[0], spot[1], dx, dy, self.walls, last) for dx, dy in moves]
        return self.low + self.cell * np.array(ends)

    def _outside(self, spot: Floats) -> Floats:
        """A spot [2] in cells, moved to the nearest face of a wall that it overlaps a little."""
        for wall in self.walls:
            depth = np.concatenate([spot - wall[:2], wall[2:] - spot])
            side = int(depth.argmin())
            if depth[side] > 0:
                spot = spot.copy()
                spot[side % 2] = wall[side]
        return np.clip(spot, 0, self.size - 1)


@lru_cache(maxsize=4)
def lattice(
    walls: tuple[Rect, ...], *, low: float, high: float, step: float, cell: float
) -> Lattice:
    """The lattice of a layout, kept for the next caller."""
    return Lattice(walls, low=low, high=high, step=step, cell=cell)


def _cells(length: float, cell: float) -> int:
    count = round(length / cell)
    if abs(length / cell - count) > 1e-3:
        raise ConfigError(f"length {length:g} is not a multiple of the lattice cell {cell:g}")
    return count


@njit(cache=True)
def _inside(x: float, y: float, walls: Floats) -> bool:
    for i in range(walls.shape[0]):
        if walls[i, 0] < x < walls[i, 2] and walls[i, 1] < y < walls[i, 3]:
            return True
    return False


@njit(cache=True)
def _slide(
    x: float, y: float, dx: float, dy: float, walls: Floats, last: float
) -> tuple[float, float]:
    """End of a displacement in cells, in microsteps of half a cell that stop at wall faces."""
    microsteps = 2 * int(np.ceil(max(abs(dx), abs(dy)))) + 1
    ux, uy = dx / microsteps, dy / microsteps
    for _ in range(microsteps):
        nx = min(max(x + ux, 0.0), last)
        if _inside(nx, y, walls):
            nx = np.floor(nx) if ux > 0 else np.ceil(nx)
        x = nx
        ny = min(max(y + uy, 0.0), last)
        if _inside(x, ny, walls):
            ny = np.floor(ny) if uy > 0 else np.ceil(ny)
        y = ny
    return x, y


@njit(cache=True)
def _clear(x0: int, y0: int, x1: int, y1: int, walls: Floats) -> bool:
    """Whether the box between two cells meets no wall's inside."""
    for i in range(walls.shape[0]):
        apart_x = max(x0, x1) <= walls[i, 0] or min(x0, x1) >= walls[i, 2]
        apart_y = max(y0, y1) <= walls[i, 1] or min(y0, y1) >= walls[i, 3]
        if not (apart_x or apart_y):
            return False
    return True


@njit(cache=True)
def _free_cells(walls: Floats, size: int) -> NDArray[np.uint8]:
    free = np.zeros((size, size), dtype=np.uint8)
    for y in range(size):
        for x in range(size):
            free[y, x] = not _inside(x, y, walls)
    return free


@njit(cache=True)
def _moves(walls: Floats, size: int, reach: int) -> NDArray[np.uint8]:
    span = 2 * reach + 1
    into = np.zeros((size, size, span, span), dtype=np.uint8)
    for y in range(size):
        for x in range(size):
            if _inside(x, y, walls):
                continue
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    tx = min(max(x + dx, 0), size - 1)
                    ty = min(max(y + dy, 0), size - 1)
                    if not _clear(x, y, tx, ty, walls):
                        end = _slide(float(x), float(y), float(dx), float(dy), walls, size - 1.0)
                        tx, ty = int(np.floor(end[0] + 0.5)), int(np.floor(end[1] + 0.5))
                    into[ty, tx, ty - y + reach, tx - x + reach] = 1
    return into


@njit(cache=True)
def _flood(into: NDArray[np.uint8], goal: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Breadth-first search backwards from the goal cells: i16 [ny, nx]."""
    size, span = into.shape[0], into.shape[2]
    reach = span // 2
    steps = np.full((size, size), UNREACHABLE, dtype=np.int16)
    queue = np.empty(size * size, dtype=np.int32)
    head, tail = 0, 0
    for i in range(size * size):
        if goal[i // size, i % size]:
            steps[i // size, i % size] = 0
            queue[tail] = i
            tail += 1
    while head < tail:
        y, x = queue[head] // size, queue[head] % size
        head += 1
        for dy in range(span):
            for dx in range(span):
                if not into[y, x, dy, dx]:
                    continue
                sy, sx = y - dy + reach, x - dx + reach
                if steps[sy, sx] == UNREACHABLE:
                    steps[sy, sx] = steps[y, x] + 1
                    queue[tail] = sy * size + sx
                    tail += 1
    return steps
