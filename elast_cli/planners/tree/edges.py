"""Edges of the trees: between candidates and their neighbours, in order of what they promise."""

from __future__ import annotations

import numpy as np

from elast_cli.compiled import njit
from elast_cli.planners.grid import NONE
from elast_cli.planners.tree.forest import Forest
from elast_cli.shapes import Bool, Float32, Int32, Int64


@njit(nogil=True)
def _place(index: Int32, row: int, node: int, capacity: int) -> int:
    """The index of a node: its own, or where candidate `node` - N went."""
    return index[row, node - capacity] if node >= capacity else node


@njit(nogil=True)
def edges_around(pairs: Int32, gaps: Float32, index: Int32, capacity: int) -> tuple[Int32, Float32]:
    """Edges (row, source, target) [3,2P] into inserted candidates, then the same reversed.

    Args:
        pairs: (row, k, node) [3,P'] of candidates and nodes near by, where N + j is candidate j;
            pairs of which one is not in the tree drop out.
        gaps: their squared lengths [P'].
        index: where candidates went [B,K].
        capacity: most nodes of a tree, N.

    Returns:
        The edges and their squared lengths [2P].
    """
    count = 0
    for p in range(len(gaps)):
        b = pairs[0, p]
        other = _place(index, b, pairs[2, p], capacity)
        count += index[b, pairs[1, p]] != NONE and other != NONE
    edges = np.empty((3, 2 * count), np.int32)
    gap = np.empty(2 * count, np.float32)
    into = 0
    for p in range(len(gaps)):
        b = pairs[0, p]
        new, other = index[b, pairs[1, p]], _place(index, b, pairs[2, p], capacity)
        if new != NONE and other != NONE:
            out_of = into + count
            edges[0, into] = edges[0, out_of] = b
            edges[1, into] = edges[2, out_of] = other
            edges[2, into] = edges[1, out_of] = new
            gap[into] = gap[out_of] = gaps[p]
            into += 1
    return edges, gap


@njit(nogil=True)
def pick(forest: Forest, edges: Int32, gap: Float32, untried: Bool) -> tuple[Int32, Int32, Int32]:
    """For each target the cheapest untried edge that lowers its cost; of equals, the shortest.

    Edges are given as (row, source, target) [3,P], their squared lengths as `gap` [P]. The chosen
    are marked as tried and returned, in order: rows, sources and targets.

    Args:
        forest: the trees; `offer` is scratch, and is left as it was.
        edges: i32 [3,P].
        gap: f32 [P], in latent units².
        untried: bool [P], changed in place.

    Returns:
        i32 [Q] each, with Q ≤ P.
    """
    depth, offer = forest.depth, forest.offer
    row, source, target = edges
    for e in range(len(row)):
        b, i, j = row[e], source[e], target[e]
        if not untried[e] or depth[b, i] + 1 >= depth[b, j]:
            continue
        best = offer[b, j]
        if best == NONE or (depth[b, i], gap[e], i) < (
            depth[b, source[best]],
            gap[best],
            source[best],
        ):
            offer[b, j] = e
    chosen = np.empty(len(row), np.int64)
    count = 0
    for e in range(len(row)):
        if untried[e] and offer[row[e], target[e]] == e:
            offer[row[e], target[e]] = NONE
            untried[e] = False
            chosen[count] = e
            count += 1
    chosen = chosen[:count]
    return row[chosen], source[chosen], target[chosen]


@njit(nogil=True)
def ends(
    forest: Forest, row: Int32, source: Int32, target: Int32
) -> tuple[Float32, Float32, Int64]:
    """Latents at both ends of edges (row, source, target) [P], each [P,Z], and the rows [P].

    Args:
        forest: the trees.
        row: tree of each edge, i32 [P].
        source: node that it leaves, i32 [P].
        target: node that it leads to, i32 [P].

    Returns:
        f32 [P,Z] twice, and i64 [P].
    """
    z = np.empty((len(row), forest.latent.shape[2]), np.float32)
    z_next = np.empty_like(z)
    for e in range(len(row)):
        z[e] = forest.latent[row[e], source[e]]
        z_next[e] = forest.latent[row[e], target[e]]
    return z, z_next, row.astype(np.int64)


@njit(nogil=True)
def flat(
    row: Int64 | Int32, source: Int32, target: Int64 | Int32, width: int, calls: Int64
) -> tuple[Int64, Int64]:
    """Places of edges' ends [P] in a table of `width` for each row; counts them in calls [B].

    Args:
        row: tree of each edge, i64 or i32 [P].
        source: i32 [P].
        target: i64 or i32 [P].
        width: entries of the table for each row.
        calls: i64 [B]; each edge adds 1 to its row, in place.

    Returns:
        Indices of sources and of targets, i64 [P] each.
    """
    here, there = np.empty(len(row), np.int64), np.empty(len(row), np.int64)
    for e in range(len(row)):
        here[e], there[e] = row[e] * width + source[e], row[e] * width + target[e]
        calls[row[e]] += 1
    return here, there


@njit(nogil=True)
def count(calls: Int64, row: Int64, each: int) -> None:
    """Add `each` to the calls [B] of every row that is named [M].

    Args:
        calls: i64 [B], changed in place.
        row: i64 [M]; a row may be named several times.
        each: calls for each time that a row is named.
    """
    for e in range(len(row)):
        calls[row[e]] += each


@njit(nogil=True)
def lengths(x: Float32) -> Float32:
    """Euclidean length [M] of each row [M,Z]."""
    out = np.empty(len(x), np.float32)
    for m in range(len(x)):
        total = np.float32(0)
        for d in range(x.shape[1]):
            total += x[m, d] * x[m, d]
        out[m] = np.sqrt(total)
    return out


@njit(nogil=True)
def lands(landed: Float32, z_next: Float32, variance: Float32, radius: float, most: float) -> Bool:
    """Which of `landed` [M,Z] lie within `radius` of z' [M,Z] with a variance up to `most` [M].

    Args:
        landed: latents f32 [M,Z].
        z_next: z', latents f32 [M,Z].
        variance: of the predictions f32 [M], in latent units².
        radius: in latent units.
        most: greatest variance, in latent units².

    Returns:
        bool [M].
    """
    near: Bool = lengths(landed - z_next) <= radius
    return near & (variance <= most)
