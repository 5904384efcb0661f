"""A map of the latent space: encoded states as nodes, and the edges that may join them.

No edge is tested here, because obstacles may differ between scenarios.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from elast_cli.shapes import Bool, Float32, Float64, Int32, Int64

TIE = 1e-3  # weight of an edge's length in radii: among equally many steps the shortest path wins


@dataclass(frozen=True)
class Roadmap:
    """Nodes, and directed edges sorted by the node that they leave.

    Attributes:
        latents: of the nodes [N,Z].
        source, target: ends of the edges [E].
        length: of the edges, in latent units [E].
        observed: whether a transition from one end to the other was seen [E].
        radius: within which any two nodes are joined, in latent units.
        tree: of the nodes, for the search of neighbours.
    """

    latents: Float32
    source: Int32
    target: Int32
    length: Float32
    observed: Bool
    radius: float
    tree: cKDTree

    @cached_property
    def first(self) -> Int64:
        """Where in the edges those of each node begin, and their number at the end: [N+1]."""
        found: Int64 = np.searchsorted(self.source, np.arange(len(self.latents) + 1))
        return found

    def near(self, z: Float32) -> Int64:
        """Nodes [M] within the radius of a latent [Z], in order."""
        return np.sort(np.array(self.tree.query_ball_point(z, self.radius), np.int64))

    def cost(self, length: Float32) -> Float64:
        """Costs of edges of these lengths [E]: one step each, and a little for the length."""
        costs: Float64 = 1 + TIE * length.astype(np.float64) / self.radius
        return costs


def roadmap(latents: Float32, rows: Int64, *, spacing: float, radius: float) -> Roadmap:
    """The map of encoded states.

    Args:
        latents: of the states [M,Z], in the order of the dataset.
        rows: in the dataset [M]; a state was seen to lead to the next one if its row is the next.
        spacing: a state nearer than that to earlier nodes is merged into the first of them.
        radius: within which two nodes are joined.
    """
    nodes, node_of = merged(latents, spacing)
    kept = np.ascontiguousarray(latents[nodes])
    tree = cKDTree(kept)
    pairs = tree.query_pairs(radius, output_type="ndarray").astype(np.int64).reshape(-1, 2)
    follows = np.flatnonzero(np.diff(rows) == 1)
    seen = np.stack([node_of[follows], node_of[follows + 1]], axis=1)
    seen = seen[seen[:, 0] != seen[:, 1]]
    every = np.concatenate([seen, pairs, pairs[:, ::-1]])
    keys, first = np.unique(every[:, 0] * len(kept) + every[:, 1], return_index=True)
    source, target = np.divmod(keys, len(kept))
    gap = kept[target] - kept[source]
    return Roadmap(
        latents=kept,
        source=source.astype(np.int32),
        target=target.astype(np.int32),
        length=np.linalg.norm(gap, axis=1).astype(np.float32),
        observed=first < len(seen),
        radius=radius,
        tree=tree,
    )


def merged(latents: Float32, spacing: float) -> tuple[Int64, Int64]:
    """States [N] that stay nodes, and the node [M] that each state [M,Z] becomes a part of.

    In order, a state is a node unless one that came before is nearer than the spacing.
    """
    node_of = np.full(len(latents), -1)
    nodes: list[int] = []
    around = cKDTree(latents).query_ball_point(latents, spacing) if spacing > 0 else None
    for i in range(len(latents)):
        if node_of[i] < 0:
            own = np.array([i] if around is None else around[i])
            node_of[own[node_of[own] < 0]] = len(nodes)
            nodes.append(i)
    return np.array(nodes, np.int64), node_of


@dataclass(frozen=True)
class Paths:
    """Shortest paths to N nodes: their costs [N], and the node before each [N]; N is the start."""

    cost: Float64
    before: Int32

    def to(self, node: int) -> list[int]:
        """The nodes of the path to a node, the start left out."""
        path = [node]
        while self.before[path[-1]] != len(self.before):
            path.append(int(self.before[path[-1]]))
        return path[::-1]


def shortest_from(edges: Roadmap, usable: Bool, joined: Int64, length: Float32) -> Paths:
    """Shortest paths from a start outside of the map to every node; the cost of none is infinite.

    Args:
        edges: the map.
        usable: which of its edges paths may take [E].
        joined: nodes [J] that the start is joined to.
        length: of these edges [J].
    """
    count = len(edges.latents)
    pointers = np.concatenate([[0], np.cumsum(usable)])[edges.first]
    indices = np.concatenate([edges.target[usable], joined.astype(np.int32)])
    cost = edges.cost(np.concatenate([edges.length[usable], length]))
    pointers = np.append(pointers, len(indices)).astype(np.int32)
    graph = csr_array((cost, indices, pointers), shape=(count + 1, count + 1))
    costs, before = dijkstra(graph, indices=count, return_predecessors=True)
    return Paths(costs[:count], before[:count])
