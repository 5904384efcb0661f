"""B search trees in preallocated arrays, and the compiled bookkeeping that grows and rewires them.

Costs are numbers of steps, so a node's cost is its depth. Every change of a cost is carried to the
whole subtree below it at once; depths are therefore always exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from elast_cli.compiled import njit
from elast_cli.planners.grid import NONE
from elast_cli.shapes import Bool, Float32, Int32, Int64


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

    Args:
        start: latents of the roots f32 [B,Z].
        feature: of the roots f32 [B,E].
        goal: latents f32 [B,Z].
        nodes: most nodes of a tree, N.
        extra: slots for the features of candidates, K.
        actions: size of an action, A.
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


@njit(nogil=True)
def _detach(forest: Forest, b: int, i: int) -> None:
    left, right = forest.before[b, i], forest.after[b, i]
    if left == NONE:
        forest.child[b, forest.parent[b, i]] = right
    else:
        forest.after[b, left] = right
    if right != NONE:
        forest.before[b, right] = left


@njit(nogil=True)
def _attach(forest: Forest, b: int, i: int, to: int) -> None:
    head = forest.child[b, to]
    forest.parent[b, i] = to
    forest.after[b, i] = head
    forest.before[b, i] = NONE
    if head != NONE:
        forest.before[b, head] = i
    forest.child[b, to] = i


@njit(nogil=True)
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


@njit(nogil=True)
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


@njit(nogil=True)
def link(forest: Forest, b: int, parent: Int32) -> None:
    """Hang the nodes of tree b from their parents [N], and find the one nearest to the goal.

    Args:
        forest: the trees, changed in place; tree b's latents must be set.
        b: index of the tree.
        parent: of each node i32 [N]; -1 where there is none, as at the root.
    """
    for i in range(len(parent)):
        forest.child[b, i] = forest.offer[b, i] = NONE
    for i in range(len(parent)):
        if parent[i] != NONE:
            _attach(forest, b, i, parent[i])
        _note_goal(forest, b, i)


@njit(nogil=True)
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


@njit(nogil=True)
def rewire(
    forest: Forest, row: Int32, source: Int32, target: Int32, action: Float32, admissible: Bool
) -> int:
    """Offer the admissible edges (row, source, target) [P] in order, with their actions [P,A].

    Each that lowers the cost of its target at that moment is taken. Returns how many were.

    Args:
        forest: the trees, changed in place.
        row: tree of each edge, i32 [P].
        source: node that it leaves, i32 [P].
        target: node that it leads to, i32 [P].
        action: f32 [P,A].
        admissible: bool [P].
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


def path_to(forest: Forest, b: int, node: int) -> list[int]:
    """Node indices from the root of tree b to `node`.

    Args:
        forest: the trees.
        b: index of the tree.
        node: index of the last node.
    """
    path = [node]
    while forest.parent[b, path[-1]] != NONE:
        path.append(int(forest.parent[b, path[-1]]))
    return path[::-1]
