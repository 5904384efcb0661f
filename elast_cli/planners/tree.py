"""B search trees in preallocated arrays, and the compiled bookkeeping that grows and rewires them.

Costs are numbers of steps, so a node's cost is its depth. Every change of a cost is carried to the
whole subtree below it at once; depths are therefore always exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

NONE = -1


@dataclass(frozen=True)
class Forest:
    """B trees of at most N nodes; the K slots from N on hold the candidates of the current batch.

    Attributes:
        latent: node states [B,N+K,Z].
        feature: what ψ needs of each node [B,N+K,E].
        action: action [B,N,A] on the edge from the parent.
        parent: parent's index [B,N]; -1 at the root.
        depth: number of steps from the root [B,N].
        crowding: neighbours plus rejections [B,N]; sparse nodes have little of it.
        child, after, before: linked lists of children [B,N]: first child, siblings.
        size: number of nodes [B].
        nearest: node nearest to the goal [B], and its distance [B].
    """

    latent: Float32
    feature: Float32
    action: Float32
    parent: Int32
    depth: Int32
    crowding: Int32
    child: Int32
    after: Int32
    before: Int32
    size: Int64
    nearest: Int64
    nearest_distance: Float32

    @property
    def capacity(self) -> int:
        """Most nodes a tree can hold, N."""
        return int(self.parent.shape[1])


def plant(
    start: Float32, feature: Float32, goal: Float32, *, nodes: int, extra: int, actions: int
) -> Forest:
    """Trees of one node each, at `start` [B,Z] with features [B,E]; room for `nodes` in each."""
    b, z = start.shape
    links = [np.full((b, nodes), NONE, np.int32) for _ in range(4)]
    forest = Forest(
        latent=np.zeros((b, nodes + extra, z), np.float32),
        feature=np.zeros((b, nodes + extra, feature.shape[1]), np.float32),
        action=np.zeros((b, nodes, actions), np.float32),
        parent=links[0],
        depth=np.zeros((b, nodes), np.int32),
        crowding=np.zeros((b, nodes), np.int32),
        child=links[1],
        after=links[2],
        before=links[3],
        size=np.ones(b, np.int64),
        nearest=np.zeros(b, np.int64),
        nearest_distance=np.linalg.norm(start - goal, axis=1).astype(np.float32),
    )
    forest.latent[:, 0] = start
    forest.feature[:, 0] = feature
    return forest


@njit(cache=True, nogil=True)
def choose(
    crowding: Int32,
    size: Int64,
    nearest: Int64,
    draws: Float64,
    shares: tuple[float, float],
    exponent: float,
    out: Int32,
) -> None:
    """Fill out [B,K] with the nodes to expand, from draws [B,K,2] in [0, 1) (Sec. 4.3, biases).

    shares = (p_uniform, p_sparse); the rest goes to the node nearest to the goal. A sparse draw
    weighs a node by (1 + crowding)^-exponent.
    """
    for b in range(out.shape[0]):
        n = size[b]
        cumulative = np.empty(n, np.float64)
        total = 0.0
        for i in range(n):
            total += (1.0 + crowding[b, i]) ** -exponent
            cumulative[i] = total
        for k in range(out.shape[1]):
            which, where = draws[b, k, 0], draws[b, k, 1]
            if which < shares[0]:
                out[b, k] = min(int(where * n), n - 1)
            elif which < shares[0] + shares[1]:
                out[b, k] = min(np.searchsorted(cumulative, where * total, side="right"), n - 1)
            else:
                out[b, k] = nearest[b]


@njit(cache=True, nogil=True)
def find_neighbors(
    latent: Float32,
    depth: Int32,
    size: Int64,
    capacity: int,
    new_depth: Int32,
    alive: Bool,
    radius: float,
    duplicate: float,
    pairs: Int32,
    gaps: Float32,
) -> int:
    """Write pairs (b, k, node) [P,3] of live candidates and tree nodes within `radius`.

    Their squared distances go to `gaps` [P].

    A candidate nearer than `duplicate` to a node that is no costlier is marked dead, without pairs.
    Returns the number of pairs found; where that exceeds the room in `pairs`, call again with more
    (the marks stay valid).
    """
    found = 0
    room = pairs.shape[0]
    z = latent.shape[2]
    limit, same = radius * radius, duplicate * duplicate
    for b in range(new_depth.shape[0]):
        for k in range(new_depth.shape[1]):
            if not alive[b, k]:
                continue
            first = found
            point = latent[b, capacity + k]
            for j in range(size[b]):
                gap = np.float32(0.0)
                for d in range(z):
                    step = point[d] - latent[b, j, d]
                    gap += step * step
                if gap <= limit:
                    if gap < same and depth[b, j] <= new_depth[b, k]:
                        alive[b, k] = False
                        found = first
                        break
                    if found < room:
                        pairs[found, 0] = b
                        pairs[found, 1] = k
                        pairs[found, 2] = j
                        gaps[found] = gap
                    found += 1
    return found


@njit(cache=True, nogil=True)
def _detach(b: int, i: int, parent: Int32, child: Int32, after: Int32, before: Int32) -> None:
    left, right = before[b, i], after[b, i]
    if left == NONE:
        child[b, parent[b, i]] = right
    else:
        after[b, left] = right
    if right != NONE:
        before[b, right] = left


@njit(cache=True, nogil=True)
def _attach(
    b: int, i: int, to: int, parent: Int32, child: Int32, after: Int32, before: Int32
) -> None:
    head = child[b, to]
    parent[b, i] = to
    after[b, i] = head
    before[b, i] = NONE
    if head != NONE:
        before[b, head] = i
    child[b, to] = i


@njit(cache=True, nogil=True)
def _deepen(b: int, i: int, change: int, depth: Int32, child: Int32, after: Int32) -> None:
    """Add `change` to the depth of node i and of everything below it, without recursion."""
    stack = [i]
    while len(stack) > 0:
        node = stack.pop()
        depth[b, node] += change
        below = child[b, node]
        while below != NONE:
            stack.append(below)
            below = after[b, below]


@njit(cache=True, nogil=True)
def insert(
    latent: Float32,
    feature: Float32,
    action: Float32,
    parent: Int32,
    depth: Int32,
    crowding: Int32,
    child: Int32,
    after: Int32,
    before: Int32,
    size: Int64,
    alive: Bool,
    new_parent: Int32,
    new_action: Float32,
    new_index: Int32,
) -> None:
    """Move the live candidates from their slots into the tree; new_index [B,K] says where to."""
    capacity = parent.shape[1]
    for b in range(alive.shape[0]):
        for k in range(alive.shape[1]):
            new_index[b, k] = NONE
            if not alive[b, k] or size[b] >= capacity:
                continue
            i = size[b]
            size[b] = i + 1
            new_index[b, k] = i
            latent[b, i] = latent[b, capacity + k]
            feature[b, i] = feature[b, capacity + k]
            action[b, i] = new_action[b, k]
            depth[b, i] = depth[b, new_parent[b, k]] + 1
            crowding[b, i] = 0
            child[b, i] = NONE
            _attach(b, i, new_parent[b, k], parent, child, after, before)


@njit(cache=True, nogil=True)
def rewire(
    edges: Int32,
    edge_action: Float32,
    action: Float32,
    parent: Int32,
    depth: Int32,
    child: Int32,
    after: Int32,
    before: Int32,
) -> int:
    """Offer the edges (b, from, to) [P,3] in order; take each that lowers the cost of `to` now."""
    taken = 0
    for e in range(edges.shape[0]):
        b, i, j = edges[e, 0], edges[e, 1], edges[e, 2]
        change = depth[b, i] + 1 - depth[b, j]
        if change < 0:
            _detach(b, j, parent, child, after, before)
            _attach(b, j, i, parent, child, after, before)
            _deepen(b, j, change, depth, child, after)
            action[b, j] = edge_action[e]
            taken += 1
    return taken


@njit(cache=True, nogil=True)
def update_nearest(
    latent: Float32,
    goal: Float32,
    size_before: Int64,
    size: Int64,
    nearest: Int64,
    nearest_distance: Float32,
) -> None:
    """Keep the node nearest to each goal up to date with the nodes added since `size_before`."""
    for b in range(size.shape[0]):
        for i in range(size_before[b], size[b]):
            gap = np.float32(0.0)
            for d in range(goal.shape[1]):
                step = latent[b, i, d] - goal[b, d]
                gap += step * step
            distance = np.sqrt(gap)
            if distance < nearest_distance[b]:
                nearest_distance[b] = distance
                nearest[b] = i


def path_to(forest: Forest, b: int, node: int) -> list[int]:
    """Node indices from the root of tree b to `node`."""
    path = [node]
    while forest.parent[b, path[-1]] != NONE:
        path.append(int(forest.parent[b, path[-1]]))
    return path[::-1]
