"""Drawing nodes in proportion to weights that keep changing: a binary tree of sums for each row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from elast_cli.compiled import njit
from elast_cli.planners.tree.forest import Forest
from elast_cli.seeding import generator
from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

LEAST_WEIGHT = 1e-300
BLOCK = 4096  # expansions whose random numbers are drawn at once


class Sparsity(NamedTuple):
    """How likely nodes of B trees are to be drawn for having few others around them.

    Attributes:
        sums: of the weights [B,2L], see `no_weights`; a node without weight is never drawn.
        crowding: neighbours plus rejections of each node [B,N].
        weights: of nodes by their crowding [C], see `weight_table`.
    """

    sums: Float64
    crowding: Int32
    weights: Float64


class Draws:
    """Random numbers in [0, 1) for expansions, `each` of them for one, of B rows.

    Each row has a generator of its own, and what it gives does not depend on how it is taken.
    """

    def __init__(self, seeds: Int64, each: int) -> None:
        """Begin the streams of the rows' seeds [B]."""
        self._streams = [generator("plan", int(seed)) for seed in seeds]
        self._ready: Float64 = np.empty((len(seeds), 0, each))

    def take(self, count: int) -> Float64:
        """Those of the next `count` expansions [B,count,each]."""
        missing = count - self._ready.shape[1]
        if missing > 0:
            shape = max(missing, BLOCK), self._ready.shape[2]
            fresh = np.stack([stream.random(shape) for stream in self._streams])
            self._ready = np.concatenate([self._ready, fresh], axis=1)
        taken, self._ready = self._ready[:, :count], self._ready[:, count:]
        return taken


def no_weights(rows: int, nodes: int) -> Float64:
    """Sums [B,2L] over trees of L ≥ `nodes` leaves: node i adds up 2i and 2i+1, the root is 1."""
    leaves = 1 << max(1, int(nodes - 1).bit_length())
    return np.zeros((rows, 2 * leaves))


@njit(nogil=True)
def set_weight(sums: Float64, i: int, weight: float) -> None:
    """Give leaf i of one row's sums [2L] a weight.

    Sums are added up anew and never corrected, so they depend on the weights alone and not on
    their history.

    Args:
        sums: f64 [2L] of one row, changed in place.
        i: index of the leaf, which is that of a node.
        weight: at least 0.
    """
    at = len(sums) // 2 + i
    sums[at] = weight
    while at > 1:
        at //= 2
        sums[at] = sums[2 * at] + sums[2 * at + 1]


@njit(nogil=True)
def draw(sums: Float64, where: float) -> int:
    """The leaf at a share `where` in [0, 1) of the total weight."""
    at, rest = 1, where * sums[1]
    while at < len(sums) // 2:
        at *= 2
        if rest >= sums[at] and sums[at + 1] > 0:
            rest -= sums[at]
            at += 1
    return at - len(sums) // 2


@njit(nogil=True)
def choose(
    sums: Float64,
    rows: Int64,
    size: Int64,
    nearest: Int64,
    draws: Float64,
    shares: tuple[float, float],
) -> Int32:
    """The nodes to expand [R,K], from draws [R,K,≥2] in [0, 1) (Sec. 4.3, biases).

    shares = (p_uniform, p_sparse): a uniform draw takes any of the `size` nodes [B], a sparse one
    goes by the weights; the rest goes to the node nearest to the goal [B].

    Args:
        sums: of weights f64 [B,2L], see `no_weights`.
        rows: trees to expand, i64 [R].
        size: number of nodes, i64 [B].
        nearest: node nearest to the goal, i64 [B].
        draws: f64 [R,K,≥2]; the first number picks the rule, the second the node.
        shares: probabilities of a uniform and of a sparse draw; their sum is at most 1.

    Returns:
        i32 [R,K].
    """
    out = np.empty((draws.shape[0], draws.shape[1]), np.int32)
    for r in range(len(rows)):
        b = rows[r]
        for k in range(out.shape[1]):
            which, where = draws[r, k, 0], draws[r, k, 1]
            if which < shares[0]:
                out[r, k] = min(int(where * size[b]), size[b] - 1)
            elif which < shares[0] + shares[1]:
                out[r, k] = draw(sums[b], where)
            else:
                out[r, k] = nearest[b]
    return out


def weight_table(exponent: float) -> Float64:
    """Weights [C] of nodes that 0, 1, ... others crowd: (1 + crowding)^-exponent (Sec. 4.3).

    Whatever is more crowded than the table is long weighs as its last entry. No entry is 0, since a
    node without weight is a pruned one.
    """
    weights: Float64 = np.maximum(np.power(np.arange(1.0, 1 + (1 << 12)), -exponent), LEAST_WEIGHT)
    return weights


@njit(nogil=True)
def _weigh(sparsity: Sparsity, b: int, i: int) -> None:
    """Give node i of row b the weight of its crowding."""
    crowding = min(sparsity.crowding[b, i], len(sparsity.weights) - 1)
    set_weight(sparsity.sums[b], i, sparsity.weights[crowding])


@njit(nogil=True)
def admit(sparsity: Sparsity, first: Int64, last: Int64) -> None:
    """Let nodes first[b] up to last[b] of each row be drawn.

    Args:
        sparsity: of the nodes, changed in place.
        first: index of each row's first node to admit, i64 [B].
        last: one past the index of its last one, i64 [B].
    """
    for b in range(len(first)):
        for i in range(first[b], last[b]):
            _weigh(sparsity, b, i)


@njit(nogil=True)
def _crowd_one(sparsity: Sparsity, b: int, i: int) -> None:
    sparsity.crowding[b, i] += 1
    if sparsity.sums[b, sparsity.sums.shape[1] // 2 + i] > 0:  # a node without weight keeps none
        _weigh(sparsity, b, i)


@njit(nogil=True)
def crowd_along(sparsity: Sparsity, edges: Int32, gap: Float32, limit: float) -> None:
    """Count one more at the source of each (row, source, target) [3,P] with a gap [P] ≤ limit.

    Args:
        sparsity: of the nodes, changed in place.
        edges: i32 [3,P].
        gap: f32 [P].
        limit: in the units of the gaps, which are squared lengths in the search.
    """
    for e in range(len(gap)):
        if gap[e] <= limit:
            _crowd_one(sparsity, edges[0, e], edges[1, e])


@njit(nogil=True)
def crowd_rejected(sparsity: Sparsity, rows: Int64, alive: Bool, parent: Int32) -> None:
    """Count one more at the parents [R,K] of the candidates that are not alive [R,K].

    Args:
        sparsity: of the nodes, changed in place.
        rows: trees of the candidates, i64 [R].
        alive: bool [R,K].
        parent: node that each candidate comes from, i32 [R,K].
    """
    for r in range(len(rows)):
        for k in range(parent.shape[1]):
            if not alive[r, k]:
                _crowd_one(sparsity, rows[r], parent[r, k])


@njit(nogil=True)
def prune(sparsity: Sparsity, forest: Forest, rows: Int64, radius: float, longest: float) -> None:
    """Take the weight from nodes that cannot lead to a shorter path, and give it back to others.

    A path through a node costs its depth and at least as many steps as fit into its distance to
    the goal's region. Nothing is taken from trees that have not reached it.

    Args:
        sparsity: of the nodes.
        forest: the trees.
        rows: which of them [R].
        radius: of the goal's region.
        longest: length of a step.
    """
    leaves = sparsity.sums.shape[1] // 2
    for b in rows:
        if forest.nearest_distance[b] > radius:
            continue
        cost = forest.depth[b, forest.nearest[b]]
        for i in range(forest.size[b]):
            if forest.to_goal[b, i] <= radius:
                cost = min(cost, forest.depth[b, i])
        for i in range(forest.size[b]):
            ahead = max(np.ceil((forest.to_goal[b, i] - radius) / longest), 1)
            useful = forest.depth[b, i] + ahead < cost
            if useful and sparsity.sums[b, leaves + i] == 0:
                _weigh(sparsity, b, i)
            elif not useful and sparsity.sums[b, leaves + i] > 0:
                set_weight(sparsity.sums[b], i, 0.0)
