"""Shortest paths on a complete graph of hallucinated images (HTM, Liu et al. 2020)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.special import logsumexp

from elast_cli.planners.base import Plan, PlanCost, Query, lengthened
from elast_cli.planners.hallucination.config import HallucinationConfig
from elast_cli.shapes import Float32, Float64

MOST = 600.0  # largest logarithm of a weight: sums of paths stay finite


class Imagination(Protocol):
    """Generated images as functions on arrays; an image is an embedding of Z numbers."""

    action_size: int

    def nodes(self, context: Float32, seed: int, count: int) -> Float32:
        """Generated images f32 [N,Z].

        Args:
            context: f32 [C].
            seed: of the images.
            count: how many, N.
        """
        ...

    def scores(self, z: Float32, z_next: Float32) -> Float32:
        """s(o, o') [M,N] of all pairs of images [M,Z] and [N,Z]."""
        ...


def edge_weights(scores: Float32) -> Float64:
    """Weights w_ij = Σ_k exp(s_ik - s_ij) of the edges [N,N]; the diagonal joins nothing.

    A weight is the inverse of the softmax of a row of scores, so that it is at least 1.
    """
    raw = scores.astype(np.float64)
    log_weights = logsumexp(raw, axis=1, keepdims=True) - raw
    weights: Float64 = np.exp(np.minimum(log_weights, MOST))
    np.fill_diagonal(weights, 0)
    return weights


def shortest_path(weights: Float64, start: int, goal: int) -> list[int]:
    """Nodes from `start` to `goal`, both included.

    Args:
        weights: of the edges, f64 [N,N]; 0 joins nothing.
        start: first node.
        goal: last node.
    """
    _, before = dijkstra(weights, indices=start, return_predecessors=True)
    path = [goal]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return path[::-1]


@dataclass(frozen=True)
class ImageGraph:
    """The images of one context and the weights of all edges between them.

    Attributes:
        nodes: embedded images [N,Z].
        weights: of the edges [N,N].
    """

    nodes: Float32
    weights: Float64


@dataclass(frozen=True)
class Route:
    """The nodes of a path on the graph, and its waypoints [T,Z] from the start to the goal."""

    nodes: list[int]
    states: Float32


@dataclass(frozen=True)
class HallucinationPlanner:
    """Plans by shortest paths between generated images; row i equals a solo run of row i.

    The graph of a row is made for its first plan and kept. It is complete, so that every path
    reaches the goal: `reached` is always true, and says nothing.
    """

    imagination: Imagination
    config: HallucinationConfig

    def plan(self, query: Query) -> Plan:
        """One path a row: the start, then the images between, then the goal."""
        cost = PlanCost.zero(len(query.start))
        graphs = [self.graph(query, b, cost) for b in range(len(query.start))]
        routes = [self.route(graph, query, b, cost) for b, graph in enumerate(graphs)]
        longest = max(len(route.states) for route in routes)
        return Plan(
            states=np.stack([lengthened(route.states, longest) for route in routes]),
            actions=self._no_actions(len(routes), longest - 1),
            length=np.array([len(route.states) for route in routes]),
            reached=np.ones(len(routes), np.bool_),
            cost=cost,
            memory=graphs,
        )

    def graph(self, query: Query, row: int, cost: PlanCost) -> ImageGraph:
        """The graph of a row: that of its plan before, or a new one.

        Args:
            query: with contexts, seeds and what is remembered.
            row: of the query.
            cost: to which scored pairs are added.
        """
        kept = query.memory[row] if query.memory else None
        if isinstance(kept, ImageGraph):
            return kept
        nodes = self.imagination.nodes(
            query.context[row], int(query.seed[row]), self.config.samples
        )
        cost.density_calls[row] += len(nodes) ** 2
        return ImageGraph(nodes, edge_weights(self.imagination.scores(nodes, nodes)))

    def route(self, graph: ImageGraph, query: Query, row: int, cost: PlanCost) -> Route:
        """The path of a row on its graph.

        Args:
            graph: images and weights of their edges.
            query: with start and goal.
            row: of the query.
            cost: to which scored pairs are added.
        """
        nodes, score = graph.nodes, self.imagination.scores
        start, goal = query.start[row : row + 1], query.goal[row : row + 1]
        towards = self.config.localize_goal == "to-goal"
        near_goal = score(nodes, goal)[:, 0] if towards else score(goal, nodes)[0]
        cost.density_calls[row] += 2 * len(nodes)
        first = int(score(start, nodes)[0].argmax())
        path = shortest_path(graph.weights, first, int(near_goal.argmax()))
        return Route(path, np.concatenate([start, nodes[path[1:]], goal]))

    def _no_actions(self, rows: int, steps: int) -> Float32:
        """The inverse model acts, so that a plan has no actions of its own."""
        return np.zeros((rows, steps, self.imagination.action_size), np.float32)


def weights_along(graph: ImageGraph, path: Sequence[int]) -> Float64:
    """Weights of a path's edges."""
    found: Float64 = graph.weights[list(path[:-1]), list(path[1:])]
    return found
