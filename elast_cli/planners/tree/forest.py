"""B search trees in preallocated arrays, and the compiled bookkeeping that grows and rewires them.

Costs are numbers of steps, so a node's cost is its depth. Every change of a cost is carried to the
whole subtree below it at once; depths are therefore always exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from elast_cli.planners.grid import NONE
from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

DIRECTION = 6  # where in a candidate's random numbers those of its direction begin


class Forest(NamedTuple):
    """B trees of at most N nodes.

    Attributes:
        latent: node states [B,N,Z].
        feature: what ψ needs of each node [B,N+K,E]; the K slots from N on hold candidates.
        action: action [B,N,A] on the edge from the parent.
        parent: parent's index [B,N]; -1 at the root.
        depth: number of steps from the root [B,N].
        crowding: neighbours plus rejections [B,N]; sparse nodes have little of it.
        child, after, before: linked lists of children [B,N]: first child, siblings; -1 is none.
        offer: scratch of `pick` [B,N], -1 outside of it.
        size: number of nodes [B].
        goal: [B,Z].
        to_goal: distance of each node to it [B,N].
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
    offer: Int32
    size: Int64
    goal: Float32
    to_goal: Float32
    nearest: Int64
    nearest_distance: Float32

    @property
    def capacity(self) -> int:
        """Most nodes a tree can hold, N."""
        return int(self.parent.shape[1])


def plant(
    start: Float32, feature: Float32, goal: Float32, *, nodes: int, extra: int, actions: int
) -> Forest:
    """Trees of one node each, at `start` [B,Z] with features [B,E]; room for `nodes` in each.

    Room that no node has come to is not touched, so it costs no memory.
    """
    b, z = start.shape
    links = [np.empty((b, nodes), np.int32) for _ in range(5)]
    for link in links:
        link[:, 0] = NONE
    forest = Forest(
        latent=np.zeros((b, nodes, z), np.float32),
        feature=np.zeros((b, nodes + extra, feature.shape[1]), np.float32),
        action=np.zeros((b, nodes, actions), np.float32),
        parent=links[0],
        depth=np.zeros((b, nodes), np.int32),
        crowding=np.zeros((b, nodes), np.int32),
        child=links[1],
        after=links[2],
        before=links[3],
        offer=links[4],
        size=np.ones(b, np.int64),
        goal=np.ascontiguousarray(goal),
        to_goal=np.empty((b, nodes), np.float32),
        nearest=np.zeros(b, np.int64),
        nearest_distance=np.linalg.norm(start - goal, axis=1).astype(np.float32),
    )
    forest.latent[:, 0] = start
    forest.feature[:, 0] = feature
    forest.to_goal[:, 0] = forest.nearest_distance
    return forest


@njit(cache=True, nogil=True)
def propose(
    forest: Forest,
    rows: Int64,
    parent: Int32,
    draws: Float64,
    edge_actions: float,
    momentum: float,
    momentum_noise: float,
) -> tuple[Float32, Float32]:
    """Latents [R·K,Z] of the nodes to expand, and random actions [R,K,A] to take there.

    An action is uniform, some scaled to the edge of the box; or it keeps the node's own direction.

    Args:
        forest: the trees.
        rows: which of them [R].
        parent: nodes to expand [R,K].
        draws: [R,K,6+A] in [0, 1): ..., edge?, keep?, ..., direction.
        edge_actions: share of actions scaled to the edge.
        momentum: share of directions kept.
        momentum_noise: how much of the uniform action is added to a kept one.
    """
    size, latents = forest.action.shape[2], forest.latent.shape[2]
    action = np.empty((*parent.shape, size), np.float32)
    z = np.empty((parent.size, latents), np.float32)
    noise, one = np.float32(momentum_noise), np.float32(1)
    for r in range(parent.shape[0]):
        for k in range(parent.shape[1]):
            node = parent[r, k]
            own, new = forest.action[rows[r], node], action[r, k]
            z[r * parent.shape[1] + k] = forest.latent[rows[r], node]
            reach, moved = np.float32(1e-6), False
            for d in range(size):
                new[d] = np.float32(2 * draws[r, k, DIRECTION + d] - 1)
                reach = max(reach, abs(new[d]))
                moved |= own[d] != 0
            if draws[r, k, 2] < edge_actions:
                for d in range(size):
                    new[d] /= reach
            if moved and draws[r, k, 3] < momentum:
                for d in range(size):
                    new[d] = min(max(own[d] + noise * new[d], -one), one)
    return z, action


@njit(cache=True, nogil=True)
def _detach(forest: Forest, b: int, i: int) -> None:
    left, right = forest.before[b, i], forest.after[b, i]
    if left == NONE:
        forest.child[b, forest.parent[b, i]] = right
    else:
        forest.after[b, left] = right
    if right != NONE:
        forest.before[b, right] = left


@njit(cache=True, nogil=True)
def _attach(forest: Forest, b: int, i: int, to: int) -> None:
    head = forest.child[b, to]
    forest.parent[b, i] = to
    forest.after[b, i] = head
    forest.before[b, i] = NONE
    if head != NONE:
        forest.before[b, head] = i
    forest.child[b, to] = i


@njit(cache=True, nogil=True)
def _deepen(forest: Forest, b: int, i: int, change: int) -> None:
    """Add `change` to the depth of node i and of everything below it, without recursion."""
    stack = [i]
    while len(stack) > 0:
        node = stack.pop()
        forest.depth[b, node] += change
        below = forest.child[b, node]
        while below != NONE:
            stack.append(below)
            below = forest.after[b, below]


@njit(cache=True, nogil=True)
def _note_goal(forest: Forest, b: int, i: int) -> None:
    """Note how far node i is from the goal, and whether none is nearer."""
    gap = np.float32(0)
    for d in range(forest.goal.shape[1]):
        step = forest.latent[b, i, d] - forest.goal[b, d]
        gap += step * step
    forest.to_goal[b, i] = np.sqrt(gap)
    if forest.to_goal[b, i] < forest.nearest_distance[b]:
        forest.nearest_distance[b] = forest.to_goal[b, i]
        forest.nearest[b] = i


@njit(cache=True, nogil=True)
def link(forest: Forest, b: int, parent: Int32) -> None:
    """Hang the nodes of tree b from their parents [N], and find the one nearest to the goal."""
    for i in range(len(parent)):
        forest.child[b, i] = forest.offer[b, i] = NONE
    for i in range(len(parent)):
        if parent[i] != NONE:
            _attach(forest, b, i, parent[i])
        _note_goal(forest, b, i)


@njit(cache=True, nogil=True)
def insert(
    forest: Forest, rows: Int64, latent: Float32, alive: Bool, parent: Int32, action: Float32
) -> Int32:
    """Add the live candidates to the trees of `rows` [R]; where they are now [B,K], -1 if nowhere.

    Args:
        forest: the trees; candidate k's features lie in slot N + k.
        rows: which of them [R].
        latent: of the candidates [R,K,Z].
        alive: the candidates that passed [R,K].
        parent: the nodes they come from [R,K].
        action: on the edges from there [R,K,A].
    """
    capacity = forest.parent.shape[1]
    index = np.full((len(forest.size), alive.shape[1]), NONE, np.int32)
    for r in range(len(rows)):
        b = rows[r]
        for k in range(alive.shape[1]):
            i = forest.size[b]
            if not alive[r, k] or i >= capacity:
                continue
            forest.size[b] = i + 1
            index[b, k] = i
            forest.latent[b, i] = latent[r, k]
            forest.feature[b, i] = forest.feature[b, capacity + k]
            forest.action[b, i] = action[r, k]
            forest.depth[b, i] = forest.depth[b, parent[r, k]] + 1
            forest.child[b, i] = forest.offer[b, i] = NONE
            _attach(forest, b, i, parent[r, k])
            _note_goal(forest, b, i)
    return index


@njit(cache=True, nogil=True)
def _place(index: Int32, row: int, node: int, capacity: int) -> int:
    """The index of a node: its own, or where candidate `node` - N went."""
    return index[row, node - capacity] if node >= capacity else node


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def pick(forest: Forest, edges: Int32, gap: Float32, untried: Bool) -> tuple[Int32, Int32, Int32]:
    """For each target the cheapest untried edge that lowers its cost; of equals, the shortest.

    Edges are given as (row, source, target) [3,P], their squared lengths as `gap` [P]. The chosen
    are marked as tried and returned, in order: rows, sources and targets.
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


@njit(cache=True, nogil=True)
def rewire(
    forest: Forest, row: Int32, source: Int32, target: Int32, action: Float32, admissible: Bool
) -> int:
    """Offer the admissible edges (row, source, target) [P] in order, with their actions [P,A].

    Each that lowers the cost of its target at that moment is taken. Returns how many were.
    """
    taken = 0
    for e in range(len(row)):
        b, i, j = row[e], source[e], target[e]
        change = forest.depth[b, i] + 1 - forest.depth[b, j]
        if admissible[e] and change < 0:
            _detach(forest, b, j)
            _attach(forest, b, j, i)
            _deepen(forest, b, j, change)
            forest.action[b, j] = action[e]
            taken += 1
    return taken


@njit(cache=True, nogil=True)
def ends(
    forest: Forest, row: Int32, source: Int32, target: Int32
) -> tuple[Float32, Float32, Int64]:
    """Latents at both ends of edges (row, source, target) [P], each [P,Z], and the rows [P]."""
    z = np.empty((len(row), forest.latent.shape[2]), np.float32)
    z_next = np.empty_like(z)
    for e in range(len(row)):
        z[e] = forest.latent[row[e], source[e]]
        z_next[e] = forest.latent[row[e], target[e]]
    return z, z_next, row.astype(np.int64)


@njit(cache=True, nogil=True)
def flat(
    row: Int64 | Int32, source: Int32, target: Int64 | Int32, width: int, calls: Int64
) -> tuple[Int64, Int64]:
    """Places of edges' ends [P] in a table of `width` for each row; counts them in calls [B]."""
    here, there = np.empty(len(row), np.int64), np.empty(len(row), np.int64)
    for e in range(len(row)):
        here[e], there[e] = row[e] * width + source[e], row[e] * width + target[e]
        calls[row[e]] += 1
    return here, there


@njit(cache=True, nogil=True)
def count(calls: Int64, row: Int64, each: int) -> None:
    """Add `each` to the calls [B] of every row that is named [M]."""
    for e in range(len(row)):
        calls[row[e]] += each


@njit(cache=True, nogil=True)
def lengths(x: Float32) -> Float32:
    """Euclidean length [M] of each row [M,Z]."""
    out = np.empty(len(x), np.float32)
    for m in range(len(x)):
        total = np.float32(0)
        for d in range(x.shape[1]):
            total += x[m, d] * x[m, d]
        out[m] = np.sqrt(total)
    return out


@njit(cache=True, nogil=True)
def lands(landed: Float32, z_next: Float32, variance: Float32, radius: float, most: float) -> Bool:
    """Which of `landed` [M,Z] lie within `radius` of z' [M,Z] with a variance up to `most` [M]."""
    near: Bool = lengths(landed - z_next) <= radius
    return near & (variance <= most)


def path_to(forest: Forest, b: int, node: int) -> list[int]:
    """Node indices from the root of tree b to `node`."""
    path = [node]
    while forest.parent[b, path[-1]] != NONE:
        path.append(int(forest.parent[b, path[-1]]))
    return path[::-1]
