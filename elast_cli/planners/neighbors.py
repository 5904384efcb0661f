"""Points of a grid within a radius: pairs, copies, and whether there is any.

Each search walks cells and blocks in loops of its own: one walk shared by those for copies and for
support made the former take twice as long.
"""

from __future__ import annotations

import numpy as np

from elast_cli.compiled import njit
from elast_cli.planners.grid import BLOCK, NONE, Cells, bucket_of, cell_key, project
from elast_cli.shapes import Bool, Float32, Int32, Int64

SLACK = 1e-5  # of a radius: float32 distances may round down to within it


@njit(nogil=True)
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


@njit(nogil=True)
def _reach(cells: Cells, query: Float32, radius: float) -> tuple[int, int, int, int]:
    """First and last cells along both axes that hold points within `radius` of `query` [Z]."""
    side, reach = cells.side[0], radius * (1 + SLACK)
    x, y = project(query, cells.axes)
    return (
        int(np.floor((x - reach) / side)),
        int(np.floor((x + reach) / side)),
        int(np.floor((y - reach) / side)),
        int(np.floor((y + reach) / side)),
    )


@njit(nogil=True)
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
            key = cell_key(u, v)
            block = cells.head[b, bucket_of(key, cells.head.shape[1])]
            while block != NONE:
                if cells.key[b, block] == key:
                    _measure(cells.at, b, block, query, scratch)
                    for i in range(cells.size[b, block]):
                        out[found], gaps[found] = cells.who[b, block, i], scratch[i]
                        found += scratch[i] <= limit
                block = cells.after[b, block]
    return found


@njit(nogil=True)
def _any_in_cell(
    cells: Cells, b: int, key: int, query: Float32, limit: float, scratch: Float32
) -> bool:
    block = cells.head[b, bucket_of(key, cells.head.shape[1])]
    while block != NONE:
        if cells.key[b, block] == key:
            _measure(cells.at, b, block, query, scratch)
            for i in range(cells.size[b, block]):
                if scratch[i] <= limit:
                    return True
        block = cells.after[b, block]
    return False


@njit(nogil=True)
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
            key = cell_key(u, v)
            block = cells.head[b, bucket_of(key, cells.head.shape[1])]
            while block != NONE:
                if cells.key[b, block] == key:
                    _measure(cells.at, b, block, query, scratch)
                    for i in range(cells.size[b, block]):
                        if scratch[i] < limit and cost[b, cells.who[b, block, i]] <= most:
                            return True
                block = cells.after[b, block]
    return False


@njit(nogil=True)
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


@njit(nogil=True)
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

    Args:
        cells: the points.
        rows: which row of the points each row of the queries belongs to, i64 [R].
        queries: f32 [R,K,Z].
        wanted: the queries to look at, bool [R,K]; changed in place.
        radius: in the points' units.
        cost: of the points, in steps, i32 [B,N].
        new_cost: of the queries, in steps, i32 [R,K].
    """
    scratch = np.empty(BLOCK, np.float32)
    for r in range(len(rows)):
        b = rows[r]
        for k in range(queries.shape[1]):
            if wanted[r, k]:
                most = new_cost[r, k]
                wanted[r, k] = not _is_copy(cells, b, queries[r, k], radius, cost, most, scratch)


@njit(nogil=True)
def any_within(cells: Cells, queries: Float32, radius: float) -> Bool:
    """Whether any point of the first row lies within `radius` of each query [M,Z]: [M].

    The query's own cell is looked at first: where there is one at all, it is most often there.

    Args:
        cells: the points; only row 0 is searched.
        queries: f32 [M,Z].
        radius: in the points' units.

    Returns:
        bool [M].
    """
    scratch = np.empty(BLOCK, np.float32)
    out = np.empty(len(queries), np.bool_)
    limit, side = radius * radius, cells.side[0]
    for m in range(len(queries)):
        query = queries[m]
        x, y = project(query, cells.axes)
        own = cell_key(int(np.floor(x / side)), int(np.floor(y / side)))
        out[m] = _any_in_cell(cells, 0, own, query, limit, scratch)
        left, right, low, high = _reach(cells, query, radius)
        for u in range(left, right + 1):
            for v in range(low, high + 1):
                key = cell_key(u, v)
                if not out[m] and key != own:
                    out[m] = _any_in_cell(cells, 0, key, query, limit, scratch)
    return out
