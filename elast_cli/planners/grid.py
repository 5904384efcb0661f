"""Points in the cells of a grid, for the search of neighbours without looking at every point.

The grid spans the two axes along which the points spread the most. A projection makes no distance
longer, so whatever is within a radius lies in a cell near by; the exact distance then decides.
Points of a cell lie together in blocks, coordinate by coordinate, so that the distances to a whole
block are computed at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from elast_cli.compiled import njit
from elast_cli.shapes import Float32, Float64, Int32, Int64

NONE = -1  # no such block or node
AXES = 2  # of the grid
BLOCK = 16  # points
MOST_BUCKETS = 18  # as a power of two: they are the only memory that is touched at once


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
    """Room for `points` in each of `rows`; `axes` [Z,D] may have fewer than two columns.

    Args:
        rows: number of rows, B.
        points: most points of a row, N.
        axes: orthonormal directions f64 [Z,D]; the first two are used.
        side: length of a cell's side, in the points' units.
    """
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


@njit(nogil=True)
def cell_key(x: int, y: int) -> int:
    """One number for the cell in column x and row y."""
    return (x << 32) ^ (y & 0xFFFFFFFF)


@njit(nogil=True)
def bucket_of(key: int, buckets: int) -> int:
    """The bucket of a cell in a hash table of a power of two."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return int((mixed >> np.uint64(32)) & np.uint64(buckets - 1))


@njit(nogil=True)
def project(point: Float32, axes: Float64) -> tuple[float, float]:
    """Coordinates of a point [Z] along both axes [Z,2]."""
    x, y = 0.0, 0.0
    for d in range(len(point)):
        x += point[d] * axes[d, 0]
        y += point[d] * axes[d, 1]
    return x, y


@njit(nogil=True)
def _open_block(cells: Cells, b: int, key: int) -> int:
    """A block of the cell with room in it; only the latest block of a cell may have any."""
    bucket = bucket_of(key, cells.head.shape[1])
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


@njit(nogil=True)
def add(cells: Cells, points: Float32, first: Int64, last: Int64) -> None:
    """Sort points [B,N,Z] with indices from first[b] up to last[b] into their cells.

    Args:
        cells: the grid, changed in place.
        points: f32 [B,N,Z]; those with other indices are not read.
        first: index of each row's first new point, i64 [B].
        last: one past the index of each row's last new point, i64 [B].
    """
    side = cells.side[0]
    for b in range(len(first)):
        for i in range(first[b], last[b]):
            x, y = project(points[b, i], cells.axes)
            key = cell_key(int(np.floor(x / side)), int(np.floor(y / side)))
            block = _open_block(cells, b, key)
            slot = cells.size[b, block]
            cells.size[b, block] = slot + 1
            cells.who[b, block, slot] = i
            for d in range(points.shape[2]):
                cells.at[b, block, d, slot] = points[b, i, d]
