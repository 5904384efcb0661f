"""Least number of steps between places, under the true action bound.

One step is any displacement within an L-infinity ball, made at constant velocity. A `Grid` holds
the free cells of a square, as in the joint space of an arm, and every place is rounded to it.
Among rectangles, `lattice.Lattice` needs rounding only where a corner is rounded.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elast_cli.compiled import njit

Floats = NDArray[np.float64]
UNREACHABLE = -1


class Moves:
    """All one-step moves between the cells of a square grid.

    `into[y, x, dy, dx]` (u8) says whether one step leads from cell (x - dx, y - dy) to cell (x, y);
    dx and dy count from `least`. A field, i16 [ny, nx], holds every cell's steps to a goal region.
    """

    def __init__(
        self, into: NDArray[np.uint8], least: NDArray[np.int64], *, low: float, cell: float
    ) -> None:
        """Remember the moves; cell 0 is the place `low` on both axes.

        Args:
            into: u8 [n, n, DY, DX].
            least: displacement (x, y) that index 0 stands for, in cells, i64 [2].
            low: coordinate of cell 0.
            cell: distance of two cells, in the same unit.
        """
        self.into, self.least = into, least
        self.low, self.cell, self.size = low, cell, into.shape[0]

    def steps(self, field: NDArray[np.int16], place: NDArray[np.floating]) -> int:
        """Steps from a place [2]: the least of the cells round it, -1 if none reaches the goal."""
        spot = (np.asarray(place, dtype=np.float64) - self.low) / self.cell
        first = np.clip(np.floor(spot + 1e-4).astype(int), 0, self.size - 1)
        last = np.clip(np.ceil(spot - 1e-4).astype(int), 0, self.size - 1)
        near = field[first[1] : last[1] + 1, first[0] : last[0] + 1]
        reached = near[near != UNREACHABLE]
        return int(reached.min()) if reached.size else UNREACHABLE


class Grid(Moves):
    """Moves over a grid of which some cells are free, each at constant velocity and sliding."""

    def __init__(self, free: NDArray[np.uint8], *, low: float, cell: float, reach: int) -> None:
        """Compute every move by up to `reach` cells an axis among the cells `free` u8 [n, n].

        Args:
            free: which cells are free, y by rows, u8 [n, n].
            low: coordinate of cell 0, on both axes.
            cell: distance of two cells, in the same unit.
            reach: cells of the longest displacement on an axis.
        """
        self.free = free
        least = np.array([-reach, -reach], dtype=np.int64)
        super().__init__(_moves_between(free, reach), least, low=low, cell=cell)

    def field(self, goal: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Steps from every cell to the free ones of a region u8 [n, n]: i16 [n, n], or -1."""
        steps: NDArray[np.int16] = flood(self.into, goal & self.free, self.least)
        return steps


@njit()
def _moves_between(free: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
    """Moves of a `Grid`: where a displacement leads that is made in parts of half a cell.

    Cells u8 [n, n] to moves u8 [n, n, D, D], D = 2 reach + 1, as in `Moves`.
    A part that would end in a cell that is not free is made on the first axis alone, then on the
    second, or not at all.
    """
    size = free.shape[0]
    into = np.zeros((size, size, 2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    for y in range(size):
        for x in range(size):
            if not free[y, x]:
                continue
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    parts = 2 * max(abs(dx), abs(dy), 1)
                    px, py = float(x), float(y)
                    for _ in range(parts):
                        nx = min(max(px + dx / parts, 0.0), size - 1.0)
                        ny = min(max(py + dy / parts, 0.0), size - 1.0)
                        if free[int(ny + 0.5), int(nx + 0.5)]:
                            px, py = nx, ny
                        elif free[int(py + 0.5), int(nx + 0.5)]:
                            px = nx
                        elif free[int(ny + 0.5), int(px + 0.5)]:
                            py = ny
                    tx, ty = int(px + 0.5), int(py + 0.5)
                    into[ty, tx, ty - y + reach, tx - x + reach] = 1
    return into


@njit()
def flood(
    into: NDArray[np.uint8], goal: NDArray[np.uint8], least: NDArray[np.int64]
) -> NDArray[np.int16]:
    """Breadth-first search backwards from the goal cells: i16 [ny, nx].

    Args:
        into: moves u8 [ny, nx, dy, dx], as in `Moves`.
        goal: which cells are in the goal region, u8 [ny, nx].
        least: least displacement (x, y), in cells, i64 [2].

    Returns:
        i16 [ny, nx], steps of each cell to the goal; -1 where there is no way.
    """
    size = into.shape[0]
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
        for dy in range(into.shape[2]):
            for dx in range(into.shape[3]):
                if not into[y, x, dy, dx]:
                    continue
                sy, sx = y - dy - least[1], x - dx - least[0]
                if steps[sy, sx] == UNREACHABLE:
                    steps[sy, sx] = steps[y, x] + 1
                    queue[tail] = sy * size + sx
                    tail += 1
    return steps
