"""Candidates of one batch among themselves: each beside those that come before it in its row.

The cells know a node once its batch is in the tree. Until then its batch-mates are compared here,
all with all, coordinate by coordinate.
"""

from __future__ import annotations

import numpy as np

from elast_cli.compiled import njit
from elast_cli.shapes import Bool, Float32, Int32, Int64


@njit(nogil=True)
def _gather(latent: Float32, alive: Bool, at: Float32, who: Int32) -> int:
    """Write the live ones of latents [K,Z] to at [Z,K], side by side, and their k to who [K]."""
    count = 0
    for k in range(len(alive)):
        if alive[k]:
            who[count] = k
            for d in range(latent.shape[1]):
                at[d, count] = latent[k, d]
            count += 1
    return count


@njit(nogil=True)
def _measure(at: Float32, i: int, out: Float32) -> None:
    """Squared distances [i] of point i of at [Z,K] to those before it."""
    for j in range(i):
        out[j] = 0
    for d in range(at.shape[0]):
        place = at[d, i]
        for j in range(i):
            step = place - at[d, j]
            out[j] += step * step


@njit(nogil=True)
def drop_copies(latent: Float32, alive: Bool, cost: Int32, radius: float) -> None:
    """Clear alive [R,K] where an earlier live mate, nearer than `radius`, costs no more.

    Candidates lie at latents [R,K,Z] and cost [R,K]. Of copies that cost the same the first stays.

    Args:
        latent: f32 [R,K,Z].
        alive: bool [R,K], changed in place.
        cost: in steps, i32 [R,K].
        radius: in latent units.
    """
    rows, width, size = latent.shape
    at, who = np.empty((size, width), np.float32), np.empty(width, np.int32)
    gap, limit = np.empty(width, np.float32), radius * radius
    for r in range(rows):
        for i in range(_gather(latent[r], alive[r], at, who)):
            _measure(at, i, gap)
            for j in range(i):
                if gap[j] < limit and alive[r, who[j]] and cost[r, who[j]] <= cost[r, who[i]]:
                    alive[r, who[i]] = False


@njit(nogil=True)
def add_pairs(
    rows: Int64,
    latent: Float32,
    alive: Bool,
    radius: float,
    capacity: int,
    pairs: Int32,
    gaps: Float32,
    found: int,
) -> int:
    """Write each two live mates within `radius` once, after the pairs that are there already.

    Args:
        rows: the trees [R] that the candidates are for.
        latent: of the candidates [R,K,Z].
        alive: which of them to look at [R,K].
        radius: in latent units.
        capacity: most nodes of a tree, N; mate j is written as node N + j, its slot.
        pairs: room for (row, k, node) [3,P].
        gaps: room for their squared lengths [P].
        found: how many pairs there are already.

    Returns:
        The number of pairs; where that exceeds the room, call again with more.
    """
    width, size = latent.shape[1:]
    at, who = np.empty((size, width), np.float32), np.empty(width, np.int32)
    gap, limit, room = np.empty(width, np.float32), radius * radius, len(gaps)
    for r in range(len(rows)):
        for i in range(_gather(latent[r], alive[r], at, who)):
            _measure(at, i, gap)
            for j in range(i):
                if gap[j] <= limit:
                    if found < room:
                        pairs[0, found] = rows[r]
                        pairs[1, found] = who[i]
                        pairs[2, found] = capacity + who[j]
                        gaps[found] = gap[j]
                    found += 1
    return found
