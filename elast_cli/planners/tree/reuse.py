"""Replanning that learns: what a search found stays true while the world stands still.

A plan is followed for a while; then the tree behind it is planted again at the place that execution
has reached. Nodes that the new root reaches by a tested edge keep everything below them; what hangs
from nowhere is dropped. A plan made from such a tree needs only a few more expansions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elast_cli.compiled import njit
from elast_cli.planners.grid import NONE
from elast_cli.planners.tree.edges import lengths
from elast_cli.planners.tree.forest import Forest, link
from elast_cli.shapes import Bool, Float32, Int32, Int64


@dataclass(frozen=True)
class Memory:
    """A finished tree of one scenario.

    Attributes:
        latent: [N,Z].
        feature: [N,E].
        action: [N,A], on the edge from the parent.
        parent: [N]; -1 at the root, node 0.
        depth: [N].
        crowding: [N].
    """

    latent: Float32
    feature: Float32
    action: Float32
    parent: Int32
    depth: Int32
    crowding: Int32


def alone(root: Float32, feature: Float32, actions: int) -> Memory:
    """A tree of nothing but its root: latent [Z], feature [E].

    Args:
        root: latent f32 [Z].
        feature: of the root f32 [E].
        actions: size of an action, A.
    """
    zero = np.zeros(1, np.int32)
    none = np.zeros((1, actions), np.float32)
    return Memory(root[None], feature[None], none, zero + NONE, zero, zero)


def restore(forest: Forest, b: int, memory: Memory) -> None:
    """Put a remembered tree, cheapest nodes first, in place of tree b; what has no room is left.

    Args:
        forest: the trees, changed in place.
        b: index of the tree to replace.
        memory: the remembered tree.
    """
    n = min(len(memory.depth), forest.capacity)
    forest.latent[b, :n] = memory.latent[:n]
    forest.feature[b, :n] = memory.feature[:n]
    forest.action[b, :n] = memory.action[:n]
    forest.depth[b, :n] = memory.depth[:n]
    forest.crowding[b, :n] = memory.crowding[:n]
    forest.size[b] = n
    link(forest, b, memory.parent[:n])


def remember(forest: Forest, b: int) -> Memory:
    """Copy tree b out of a forest."""
    n = int(forest.size[b])
    return Memory(
        forest.latent[b, :n].copy(),
        forest.feature[b, :n].copy(),
        forest.action[b, :n].copy(),
        forest.parent[b, :n].copy(),
        forest.depth[b, :n].copy(),
        forest.crowding[b, :n].copy(),
    )


def first(memory: Memory, count: int) -> Memory:
    """The first nodes of a tree in which parents come before their children."""
    return Memory(
        memory.latent[:count],
        memory.feature[:count],
        memory.action[:count],
        memory.parent[:count],
        memory.depth[:count],
        memory.crowding[:count],
    )


def reaches(memory: Memory, goal: Float32, radius: float) -> bool:
    """Whether any node lies within `radius` of the goal [Z].

    Args:
        memory: the tree.
        goal: latent f32 [Z].
        radius: in latent units.
    """
    return bool(lengths(memory.latent - goal).min() <= radius)


def fitted(memory: Memory, goal: Float32, radius: float, room: int) -> Memory:
    """What of a tree, its cheapest nodes first, is worth growing where there is `room` for nodes.

    A tree that is too large is cut to its cheapest nodes. If these neither reach the goal [Z], to
    within `radius`, nor leave half of the room to grow in, only the root is kept.

    Args:
        memory: the tree, its cheapest nodes first.
        goal: latent f32 [Z].
        radius: in latent units.
        room: most nodes.
    """
    kept = first(memory, room)
    if 2 * len(kept.depth) <= room or reaches(kept, goal, radius):
        return kept
    return first(memory, 1)


@njit(nogil=True)
def closed(z: Float32, failed: Float32, radius: float) -> Bool:
    """Which places [M,Z] lie within `radius` of a way that failed transitions [P,2,Z] close.

    Execution that was at z, aimed at z' and did not move has learned that the way to z' is blocked.
    From one radius away from z on, and at least there, it is closed from all sides: obstacles
    rarely block a single point.

    Args:
        z: latents f32 [M,Z].
        failed: start and aim of each transition, f32 [P,2,Z].
        radius: in latent units.

    Returns:
        bool [M].
    """
    out = np.zeros(len(z), np.bool_)
    for p in range(len(failed)):
        way = failed[p, 1] - failed[p, 0]
        squared = (way * way).sum()
        if squared == 0:
            continue
        first = radius / np.sqrt(squared)
        last = max(first, 1.0)
        for m in range(len(z)):
            along = np.float32(0)
            for d in range(z.shape[1]):
                along += (z[m, d] - failed[p, 0, d]) * way[d]
            share = np.float32(min(last, max(first, along / squared)))
            gap = np.float32(0)
            for d in range(z.shape[1]):
                gap += (z[m, d] - failed[p, 0, d] - share * way[d]) ** 2
            out[m] |= gap <= radius * radius
    return out


def without(memory: Memory, failed: Float32, radius: float) -> Memory:
    """The tree with the edges into closed places cut; what they held hangs free.

    Args:
        memory: the tree.
        failed: start and aim of each failed transition, f32 [P,2,Z].
        radius: of closed places, in latent units.
    """
    cut = (memory.parent != NONE) & closed(memory.latent, failed, radius)
    return replace(memory, parent=np.where(cut, np.int32(NONE), memory.parent))


def candidates(memory: Memory, root: Float32, radius: float) -> Int64:
    """Nodes [M] of an old tree within `radius` of the new root [Z]: those it might connect to.

    Args:
        memory: the old tree.
        root: latent f32 [Z].
        radius: in latent units.

    Returns:
        i64 [M], in order.
    """
    gap = memory.latent - root
    near: Int64 = np.flatnonzero(np.einsum("nz,nz->n", gap, gap) <= radius * radius)
    return near


def transplant(
    memory: Memory, root: Float32, feature: Float32, adopted: Int64, actions: Float32
) -> Memory:
    """The old tree hung from a new root.

    Args:
        memory: the old tree.
        root: latent [Z] of the new root.
        feature: its feature [E].
        adopted: nodes [M] that become the root's children; their edges were tested.
        actions: action [M,A] on each of these edges.

    Returns:
        The tree of all nodes that descend from the adopted ones, cheapest first; depths are exact.
    """
    order = np.argsort(memory.depth, kind="stable")
    direct = np.zeros(len(order), np.bool_)
    direct[adopted] = True
    depth = _new_depths(order, memory.parent, direct)
    kept = np.flatnonzero(depth > 0)
    kept = kept[np.argsort(depth[kept], kind="stable")]
    index = np.full(len(depth), NONE, np.int32)
    index[kept] = np.arange(1, len(kept) + 1, dtype=np.int32)
    action = memory.action.copy()
    action[adopted] = actions
    parent = np.where(direct[kept], 0, index[memory.parent[kept]])
    none = np.zeros(1, np.int32)
    return Memory(
        np.concatenate([root[None], memory.latent[kept]]),
        np.concatenate([feature[None], memory.feature[kept]]),
        np.concatenate([np.zeros_like(action[:1]), action[kept]]),
        np.concatenate([none + NONE, parent]).astype(np.int32),
        np.concatenate([none, depth[kept]]),
        np.concatenate([none, memory.crowding[kept]]),
    )


@njit(nogil=True)
def _new_depths(order: Int64, parent: Int32, direct: Bool) -> Int32:
    """Depths below the new root [N], 0 for nodes that no adopted node leads to."""
    depth = np.zeros(len(parent), np.int32)
    for i in order:  # parents before children: old depths are exact
        if direct[i]:
            depth[i] = 1
        elif parent[i] != NONE and depth[parent[i]] > 0:
            depth[i] = depth[parent[i]] + 1
    return depth
