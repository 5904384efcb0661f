"""Points in the cells of a grid: who lies within a radius, without looking at everybody.

The grid spans the two axes along which the points spread the most. A projection makes no distance
longer, so whoever is within a radius lies in a cell near by; the exact distance then decides.
Points of a cell lie together in blocks, coordinate by coordinate, so that the distances to a whole
block are computed at once. Each search walks cells and blocks in loops of its own: one walk shared
by those for copies and for support made the former take twice as long.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

NONE = -1  # no such block or node
AXES = 2  # of the grid
BLOCK = 16  # points
MOST_BUCKETS = 18  # as a power of two: they are the only memory that is touched at once
SLACK = 1e-5  # of a radius: float32 distances may round down to within it


class Cells(NamedTuple):
    """Points of B rows in blocks of 16; blocks lie in linked lists that start in a hash table.

    Attributes:
        axes: orthonormal [Z,2], float64.
        side: of a cell [1].
        head: first block of each bucket [B,H], H a power of two; -1 where it is empty.
        blocks: number of blocks in use [B].
        after: next block of the same bucket [B,N].
        key: the cell of each block [B,N].
        size: number of points in each block [B,N].
        who: their indices [B,N,16].
        at: their coordinates [B,N,Z,16].
    """

    axes: Float64
    side: Float64
    head: Int32
    blocks: Int64
    after: Int32
    key: Int64
    size: Int32
    who: Int32
    at: Float32


def empty_cells(rows: int, points: int, *, axes: Float64, side: float) -> Cells:
    """Room for `points` in each of `rows`; `axes` [Z,D] may have fewer than two columns."""
    two = np.zeros((len(axes), AXES))
    two[:, : axes.shape[1]] = axes[:, :AXES]
    buckets = 1 << min(max(4, int(points).bit_length()), MOST_BUCKETS)
    return Cells(  # at worst every point has a block of its own: memory that is hardly ever touched
        axes=two,
        side=np.array([side]),
        head=np.full((rows, buckets), NONE, np.int32),
        blocks=np.zeros(rows, np.int64),
        after=np.empty((rows, points), np.int32),
        key=np.empty((rows, points), np.int64),
        size=np.empty((rows, points), np.int32),
        who=np.empty((rows, points, BLOCK), np.int32),
        at=np.empty((rows, points, len(axes), BLOCK), np.float32),
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
def _open_block(cells: Cells, b: int, key: int) -> int:
    """A block of the cell with room in it; only the latest block of a cell may have any."""
    bucket = _bucket(key, cells.head.shape[1])
    block: int = cells.head[b, bucket]
    while block != NONE and cells.key[b, block] != key:
        block = cells.after[b, block]
    if block != NONE and cells.size[b, block] < BLOCK:
        return block
    new: int = cells.blocks[b]
    cells.blocks[b] += 1
    cells.key[b, new] = key
    cells.size[b, new] = 0
    cells.at[b, new] = 0  # what distances are computed to must at least be numbers
    cells.after[b, new] = cells.head[b, bucket]
    cells.head[b, bucket] = new
    return new


@njit(cache=True, nogil=True)
def add(cells: Cells, points: Float32, first: Int64, last: Int64) -> None:
    """Sort points [B,N,Z] with indices from first[b] up to last[b] into their cells."""
    side = cells.side[0]
    for b in range(len(first)):
        for i in range(first[b], last[b]):
            x, y = _project(points[b, i], cells.axes)
            block = _open_block(cells, b, _key(int(np.floor(x / side)), int(np.floor(y / side))))
            slot = cells.size[b, block]
            cells.size[b, block] = slot + 1
            cells.who[b, block, slot] = i
            for d in range(points.shape[2]):
                cells.at[b, block, d, slot] = points[b, i, d]


@njit(cache=True, nogil=True)
def _measure(at: Float32, b: int, block: int, query: Float32, out: Float32) -> None:
    """Squared distances [16] of a block's points to `query` [Z]; of all its places, used or not."""
    lanes = at.shape[3]
    for i in range(lanes):
        out[i] = 0
    for d in range(len(query)):
        place = query[d]
        for i in range(lanes):  # not BLOCK: unrolled, it is no vector loop
            step = place - at[b, block, d, i]
            out[i] += step * step


@njit(cache=True, nogil=True)
def _reach(cells: Cells, query: Float32, radius: float) -> tuple[int, int, int, int]:
    """First and last cells along both axes that hold points within `radius` of `query` [Z]."""
    side, reach = cells.side[0], radius * (1 + SLACK)
    x, y = _project(query, cells.axes)
    return (
        int(np.floor((x - reach) / side)),
        int(np.floor((x + reach) / side)),
        int(np.floor((y - reach) / side)),
        int(np.floor((y + reach) / side)),
    )


@njit(cache=True, nogil=True)
def _within(
    cells: Cells,
    b: int,
    query: Float32,
    radius: float,
    out: Int32,
    gaps: Float32,
    scratch: Float32,
) -> int:
    """Write points of row b within `radius` of `query` [Z], and squared distances; how many.

    `out` and `gaps` have room for a block more than there are points, `scratch` for one.
    """
    limit, found = radius * radius, 0
    left, right, low, high = _reach(cells, query, radius)
    for u in range(left, right + 1):
        for v in range(low, high + 1):
            key = _key(u, v)
            block = cells.head[b, _bucket(key, cells.head.shape[1])]
            while block != NONE:
                if cells.key[b, block] == key:
                    _measure(cells.at, b, block, query, scratch)
                    for i in range(cells.size[b, block]):
                        out[found], gaps[found] = cells.who[b, block, i], scratch[i]
                        found += scratch[i] <= limit
                block = cells.after[b, block]
    return found


@njit(cache=True, nogil=True)
def _any_in_cell(
    cells: Cells, b: int, key: int, query: Float32, limit: float, scratch: Float32
) -> bool:
    block = cells.head[b, _bucket(key, cells.head.shape[1])]
    while block != NONE:
        if cells.key[b, block] == key:
            _measure(cells.at, b, block, query, scratch)
            for i in range(cells.size[b, block]):
                if scratch[i] <= limit:
                    return True
        block = cells.after[b, block]
    return False


@njit(cache=True, nogil=True)
def _is_copy(
    cells: Cells,
    b: int,
    query: Float32,
    radius: float,
    cost: Int32,
    most: int,
    scratch: Float32,
) -> bool:
    """Whether a point nearer to `query` [Z] than `radius` costs no more than `most`."""
    limit = radius * radius
    left, right, low, high = _reach(cells, query, radius)
    for u in range(left, right + 1):
        for v in range(low, high + 1):
            key = _key(u, v)
            block = cells.head[b, _bucket(key, cells.head.shape[1])]
            while block != NONE:
                if cells.key[b, block] == key:
                    _measure(cells.at, b, block, query, scratch)
                    for i in range(cells.size[b, block]):
                        if scratch[i] < limit and cost[b, cells.who[b, block, i]] <= most:
                            return True
                block = cells.after[b, block]
    return False


@njit(cache=True, nogil=True)
def find_pairs(
    cells: Cells,
    rows: Int64,
    queries: Float32,
    wanted: Bool,
    radius: float,
    pairs: Int32,
    gaps: Float32,
) -> int:
    """Write pairs (row, k, point) [3,P] within `radius`, and their squared distances to gaps [P].

    Args:
        cells: the points.
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
    every = cells.after.shape[1]
    near, gap = np.empty(every + BLOCK, np.int32), np.empty(every + BLOCK, np.float32)
    scratch = np.empty(BLOCK, np.float32)
    for r in range(len(rows)):
        for k in range(queries.shape[1]):
            if not wanted[r, k]:
                continue
            count = _within(cells, rows[r], queries[r, k], radius, near, gap, scratch)
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
    scratch = np.empty(BLOCK, np.float32)
    for r in range(len(rows)):
        b = rows[r]
        for k in range(queries.shape[1]):
            if wanted[r, k]:
                most = new_cost[r, k]
                wanted[r, k] = not _is_copy(cells, b, queries[r, k], radius, cost, most, scratch)


@njit(cache=True, nogil=True)
def any_within(cells: Cells, queries: Float32, radius: float) -> Bool:
    """Whether any point of the first row lies within `radius` of each query [M,Z]: [M].

    The query's own cell is looked at first: where there is one at all, it is most often there.
    """
    scratch = np.empty(BLOCK, np.float32)
    out = np.empty(len(queries), np.bool_)
    limit, side = radius * radius, cells.side[0]
    for m in range(len(queries)):
        query = queries[m]
        x, y = _project(query, cells.axes)
        own = _key(int(np.floor(x / side)), int(np.floor(y / side)))
        out[m] = _any_in_cell(cells, 0, own, query, limit, scratch)
        left, right, low, high = _reach(cells, query, radius)
        for u in range(left, right + 1):
            for v in range(low, high + 1):
                key = _key(u, v)
                if not out[m] and key != own:
                    out[m] = _any_in_cell(cells, 0, key, query, limit, scratch)
    return out
