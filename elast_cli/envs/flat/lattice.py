"""Shortest steps of a point among rectangles.

The point is the centre of a block. It moves over a lattice that is aligned with every wall. Where a
wall blocks one axis of a step, the other goes on (sliding), round the wall's corner too. A stream
adds its drift to every step that begins in it. Walls, step lengths and drifts are whole numbers of
cells, so endpoints need rounding to the lattice only where a corner is rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from elast_cli.compiled import njit
from elast_cli.envs.flat.rectangles import Rect, count_cells
from elast_cli.envs.flat.shortest_path import Floats, Moves, flood


class Lattice(Moves):
    """Moves of a point in [low, high]^2 minus open rectangles; made once per layout."""

    def __init__(
        self,
        walls: Sequence[Rect],
        *,
        low: float,
        high: float,
        step: float,
        cell: float,
        stream: Rect | None = None,
        drift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Compute every move; `walls` as the point meets them, all lengths multiples of `cell`.

        A step that begins inside `stream`, its edge included, is displaced by `drift` as well.

        Args:
            walls: open rectangles that the point may not enter, in workspace widths.
            low: least coordinate of the point on both axes, in the same unit, as all below.
            high: greatest coordinate, on both axes.
            step: longest displacement on an axis.
            cell: distance of two cells.
            stream: where the drift acts; None: nowhere.
            drift: displacement (x, y) of a step.

        Raises:
            ConfigError: if a length is not a multiple of the cell.
        """
        size = count_cells(high - low, cell) + 1
        self.reach = count_cells(step, cell)
        self.walls = _in_cells(walls, low, cell)
        self.stream = _in_cells([stream] if stream else [], low, cell)
        self.drift = np.array([count_cells(part, cell) for part in drift], dtype=np.int64)
        least: NDArray[np.int64] = np.minimum(self.drift, 0) - self.reach
        most = np.maximum(self.drift, 0) + self.reach
        into = _moves(self.walls, size, self.reach, self.stream, self.drift, least, most)
        super().__init__(into, least, low=low, cell=cell)

    def field(self, goal: NDArray[np.floating], radius: float) -> NDArray[np.int16]:
        """Steps from every cell to the disc of `radius` round a goal [2]: i16 [ny, nx], or -1."""
        axis = self.low + self.cell * np.arange(self.size)
        disc = np.hypot(axis[None, :] - goal[0], axis[:, None] - goal[1]) <= radius + 1e-9
        inside: NDArray[np.uint8] = disc.astype(np.uint8)
        steps: NDArray[np.int16] = flood(
            self.into, inside & _free_cells(self.walls, self.size), self.least
        )
        return steps

    def after(self, place: NDArray[np.floating], actions: NDArray[np.floating]) -> Floats:
        """Where each action f [M, 2] in [-1, 1] leads from one place [2], sliding: f64 [M, 2]."""
        spot = self._outside((np.asarray(place, dtype=np.float64) - self.low) / self.cell)
        moves = np.asarray(actions, dtype=np.float64) * self.reach
        if _carried(spot[0], spot[1], self.stream):
            moves = moves + self.drift
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
    walls: tuple[Rect, ...],
    *,
    low: float,
    high: float,
    step: float,
    cell: float,
    stream: Rect | None = None,
    drift: tuple[float, float] = (0.0, 0.0),
) -> Lattice:
    """The lattice of a layout, kept for the next caller; arguments as in `Lattice.__init__`."""
    return Lattice(walls, low=low, high=high, step=step, cell=cell, stream=stream, drift=drift)


def _in_cells(rects: Sequence[Rect], low: float, cell: float) -> Floats:
    """Rectangles [M, 4], counted in cells from `low`."""
    corners = [[count_cells(side - low, cell) for side in rect] for rect in rects]
    return np.array(corners, dtype=np.float64).reshape(-1, 4)


@njit()
def _inside(x: float, y: float, walls: Floats) -> bool:
    """Whether a place in cells lies inside one of the walls [M, 4], edges excluded."""
    for i in range(walls.shape[0]):
        if walls[i, 0] < x < walls[i, 2] and walls[i, 1] < y < walls[i, 3]:
            return True
    return False


@njit()
def _carried(x: float, y: float, stream: Floats) -> bool:
    """Whether a stream [0 or 1, 4] takes hold at a place."""
    for i in range(stream.shape[0]):
        if stream[i, 0] <= x <= stream[i, 2] and stream[i, 1] <= y <= stream[i, 3]:
            return True
    return False


@njit()
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


@njit()
def _clear(x0: int, y0: int, x1: int, y1: int, walls: Floats) -> bool:
    """Whether the box between two cells meets no wall's inside."""
    for i in range(walls.shape[0]):
        apart_x = max(x0, x1) <= walls[i, 0] or min(x0, x1) >= walls[i, 2]
        apart_y = max(y0, y1) <= walls[i, 1] or min(y0, y1) >= walls[i, 3]
        if not (apart_x or apart_y):
            return False
    return True


@njit()
def _free_cells(walls: Floats, size: int) -> NDArray[np.uint8]:
    """Which cells lie in no wall [M, 4]: u8 [size, size], y by rows."""
    free = np.zeros((size, size), dtype=np.uint8)
    for y in range(size):
        for x in range(size):
            free[y, x] = not _inside(x, y, walls)
    return free


@njit()
def _moves(
    walls: Floats,
    size: int,
    reach: int,
    stream: Floats,
    drift: NDArray[np.int64],
    least: NDArray[np.int64],
    most: NDArray[np.int64],
) -> NDArray[np.uint8]:
    """Moves of a `Lattice`: u8 [size, size, DY, DX], displacements from `least` to `most` [2].

    Walls and stream [M, 4], reach and drift [2] are in cells.
    """
    span_x, span_y = most - least + 1
    into = np.zeros((size, size, span_y, span_x), dtype=np.uint8)
    for y in range(size):
        for x in range(size):
            if _inside(x, y, walls):
                continue
            carried = _carried(x, y, stream)
            for ay in range(-reach, reach + 1):
                for ax in range(-reach, reach + 1):
                    dx, dy = ax, ay
                    if carried:
                        dx, dy = ax + drift[0], ay + drift[1]
                    tx = min(max(x + dx, 0), size - 1)
                    ty = min(max(y + dy, 0), size - 1)
                    if not _clear(x, y, tx, ty, walls):
                        end = _slide(float(x), float(y), float(dx), float(dy), walls, size - 1.0)
                        tx, ty = int(np.floor(end[0] + 0.5)), int(np.floor(end[1] + 0.5))
                    into[ty, tx, ty - y - least[1], tx - x - least[0]] = 1
    return into
