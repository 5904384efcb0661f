"""Points in the cells of a grid: who lies within a radius, without looking at everybody.

The grid spans the first few axes along which the points spread the most. A projection shortens no
distance to more than it was, so whoever is within a radius lies in a cell near by; the exact
distance then decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

NONE = -1
AXES = 2  # of the grid
SLACK = 1e-5  # of a radius: float32 distances may round down to within it


class Cells(NamedTuple):
    """Points of B rows, those of a cell in a linked list that starts in a hash table.

    Attributes:
        axes: orthonormal [Z,2], float64.
        side: of a cell [1].
        head: first point of each bucket [B,H], H a power of two; -1 where it is empty.
        after: next point of the same bucket [B,N].
        key: each point's cell [B,N].
    """

    axes: Float64
    side: Float64
    head: Int32
    after: Int32
    key: Int64


def empty_cells(rows: int, points: int, *, axes: Float64, side: float) -> Cells:
    """Room for `points` in each of `rows`; `axes` [Z,D] may have fewer than two columns."""
    two = np.zeros((len(axes), AXES))
    two[:, : axes.shape[1]] = axes[:, :AXES]
    buckets = 1 << max(4, int(points).bit_length())
    return Cells(
        two,
        np.array([side]),
        np.full((rows, buckets), NONE, np.int32),
        np.empty((rows, points), np.int32),
        np.empty((rows, points), np.int64),
    )


def principal_axes(points: Float32) -> Float64:
    """Orthonormal directions [Z,D] along which points [M,Z] spread the most."""
    _, vectors = np.linalg.eigh(np.cov(points.T.astype(np.float64)).reshape(len(points.T), -1))
    return np.ascontiguousarray(vectors[:, ::-1][:, :AXES])


@njit(cache=True, nogil=True)
def _key(x: int, y: int) -> int:
    return (x << 32) ^ (y & 0xFFFFFFFF)


@njit(cache=True, nogil=True)
def _bucket(key: int, buckets: int) -> int:
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return int((mixed >> np.uint64(32)) & np.uint64(buckets - 1))


@njit(cache=True, nogil=True)
def _project(point: Float32, axes: Float64) -> tuple[float, float]:
    x, y = 0.0, 0.0
    for d in range(len(point)):
        x += point[d] * axes[d, 0]
        y += point[d] * axes[d, 1]
    return x, y


@njit(cache=True, nogil=True)
def add(cells: Cells, points: Float32, first: Int64, last: Int64) -> None:
    """Sort points [B,N,Z] with indices from first[b] up to last[b] into their cells."""
    side, buckets = cells.side[0], cells.head.shape[1]
    for b in range(len(first)):
        for i in range(first[b], last[b]):
            x, y = _project(points[b, i], cells.axes)
            key = _key(int(np.floor(x / side)), int(np.floor(y / side)))
            at = _bucket(key, buckets)
            cells.key[b, i] = key
            cells.after[b, i] = cells.head[b, at]
            cells.head[b, at] = i


@njit(cache=True, nogil=True)
def _within(
    cells: Cells, points: Float32, b: int, query: Float32, radius: float, out: Int32, gaps: Float32
) -> int:
    """Write the points of row b within `radius` of `query` [Z], and squared distances; how many."""
    side, buckets = cells.side[0], cells.head.shape[1]
    x, y = _project(query, cells.axes)
    reach = radius * (1 + SLACK)
    low, high = int(np.floor((y - reach) / side)), int(np.floor((y + reach) / side))
    limit, found = radius * radius, 0
    for u in range(int(np.floor((x - reach) / side)), int(np.floor((x + reach) / side)) + 1):
        for v in range(low, high + 1):
            key = _key(u, v)
            i = cells.head[b, _bucket(key, buckets)]
            while i != NONE:
                if cells.key[b, i] == key:
                    gap = np.float32(0)
                    for d in range(len(query)):
                        step = query[d] - points[b, i, d]
                        gap += step * step
                    if gap <= limit:
                        out[found], gaps[found] = i, gap
                        found += 1
                i = cells.after[b, i]
    return found


@njit(cache=True, nogil=True)
def find_pairs(
    cells: Cells,
    points: Float32,
    rows: Int64,
    queries: Float32,
    wanted: Bool,
    radius: float,
    pairs: Int32,
    gaps: Float32,
) -> int:
    """Write pairs (row, k, point) [3,P] within `radius`, and their squared distances to gaps [P].

    Args:
        cells: the points' cells.
        points: [B,N,Z].
        rows: which row of the points each row of the queries belongs to [R].
        queries: [R,K,Z].
        wanted: the queries to answer [R,K].
        radius: in the points' units.
        pairs: room for the answer.
        gaps: as much room.

    Returns:
        The number of pairs; where that exceeds the room, call again with more.
    """
    found, room = 0, len(gaps)
    near = np.empty(cells.after.shape[1], np.int32)
    gap = np.empty(cells.after.shape[1], np.float32)
    for r in range(len(rows)):
        for k in range(queries.shape[1]):
            if not wanted[r, k]:
                continue
            count = _within(cells, points, rows[r], queries[r, k], radius, near, gap)
            for i in range(min(count, room - found)):
                pairs[0, found + i] = rows[r]
                pairs[1, found + i] = k
                pairs[2, found + i] = near[i]
                gaps[found + i] = gap[i]
            found += count
    return found


@njit(cache=True, nogil=True)
def drop_copies(
    cells: Cells,
    points: Float32,
    rows: Int64,
    queries: Float32,
    wanted: Bool,
    radius: float,
    cost: Int32,
    new_cost: Int32,
) -> None:
    """Clear wanted [R,K] for queries nearer than `radius` to a point that is no costlier.

    The points cost [B,N], the queries new_cost [R,K]; the rest is as for `find_pairs`.
    """
    near = np.empty(cells.after.shape[1], np.int32)
    gap = np.empty(cells.after.shape[1], np.float32)
    for r in range(len(rows)):
        b = rows[r]
        for k in range(queries.shape[1]):
            if wanted[r, k]:
                for i in range(_within(cells, points, b, queries[r, k], radius, near, gap)):
                    if gap[i] < radius * radius and cost[b, near[i]] <= new_cost[r, k]:
                        wanted[r, k] = False


@njit(cache=True, nogil=True)
def any_within(cells: Cells, points: Float32, queries: Float32, radius: float) -> Bool:
    """Whether any of the points [1,N,Z] lies within `radius` of each query [M,Z]: [M]."""
    near = np.empty(cells.after.shape[1], np.int32)
    gap = np.empty(cells.after.shape[1], np.float32)
    out = np.empty(len(queries), np.bool_)
    for m in range(len(queries)):
        out[m] = _within(cells, points, 0, queries[m], radius, near, gap) > 0
    return out
