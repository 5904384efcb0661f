"""The search one expansion at a time, written plainly: what the batched engine is measured by.

The same algorithm with the same settings: selection, actions, tests of a transition, crowding,
pruning, rewiring with costs carried through subtrees, and the same random numbers in the same
places. numpy keeps the tree; the distances to all nodes are computed at once; the networks are
called as torch modules. Only rounding can make its tree another than the engine's.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Protocol

import numpy as np
import torch
from scipy.spatial import cKDTree

from elast_cli.methods.loading import Models
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.planners.base import Limits, Query, Radii
from elast_cli.planners.tree.actions import DIRECTION
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.seeding import generator
from elast_cli.shapes import Bool, Float32, Float64, Int64


class Networks(Protocol):
    """The learned world of one scenario, as functions of arrays with M rows."""

    action_size: int

    def step(self, z: Float32, action: Float32) -> tuple[Float32, Float32]:
        """Next latent [M,Z] of H_f from [M,Z] under [M,A], and its variance [M]."""
        ...

    def log_density(self, z: Float32, z_next: Float32) -> Float32:
        """ψ: ln p(z' | z) [M] in nats."""
        ...

    def act(self, z: Float32, z_next: Float32) -> Float32:
        """π's action [M,A] from z to z'."""
        ...

    def support_distance(self, z: Float32) -> float:
        """Distance of one latent [Z] to the nearest encoded training state."""
        ...


class TorchNetworks:
    """Trained models called through their modules; the support in a k-d tree, since it is fixed."""

    def __init__(self, models: Models, context: Float32) -> None:
        """Take frozen models on the CPU, and the scenario's context [C]."""
        dynamics = models.part("ensemble", SupportedDynamics)
        self.ensemble, self.context = dynamics.ensemble, torch.from_numpy(context)
        self.density = models.part("density", TransitionDensity)
        self.policy = models.part("policy", LocalPolicy)
        self.action_size = self.policy.action_size
        self.support = cKDTree(dynamics.support.latents.numpy())

    def _contexts(self, rows: int) -> torch.Tensor:
        return self.context.expand(rows, -1)

    @torch.inference_mode()
    def step(self, z: Float32, action: Float32) -> tuple[Float32, Float32]:
        """H_f on [M,Z], [M,A]."""
        z_next, variance = self.ensemble(
            torch.from_numpy(z), torch.from_numpy(action), self._contexts(len(z))
        )
        return z_next.numpy(), variance.numpy()

    @torch.inference_mode()
    def log_density(self, z: Float32, z_next: Float32) -> Float32:
        """ψ on [M,Z], [M,Z]."""
        found: Float32 = self.density(
            torch.from_numpy(z), torch.from_numpy(z_next), self._contexts(len(z))
        ).numpy()
        return found

    @torch.inference_mode()
    def act(self, z: Float32, z_next: Float32) -> Float32:
        """π on [M,Z], [M,Z]."""
        found: Float32 = self.policy(
            torch.from_numpy(z), torch.from_numpy(z_next), self._contexts(len(z))
        ).numpy()
        return found

    def support_distance(self, z: Float32) -> float:
        """Of one latent [Z]."""
        return float(self.support.query(z)[0])


@dataclass(frozen=True)
class SerialPlan:
    """A path: latents [T,Z], actions [T-1,A], and whether it ends within the goal radius."""

    states: Float32
    actions: Float32
    reached: bool


class SerialTree:
    """One tree of at most N nodes; node i is column i of `latent` [Z,N], node 0 the root.

    Settings that only variants of the method use are not known: counting reachable neighbours, h_f
    in place of the ensemble, and actions that π steers.
    """

    def __init__(
        self,
        networks: Networks,
        config: TreeConfig,
        limits: Limits,
        radii: Radii,
        *,
        start: Float32,
        goal: Float32,
        seed: int,
    ) -> None:
        """Plant a tree at `start` [Z] that looks for `goal` [Z].

        Raises:
            ValueError: a setting is not known.
        """
        if config.sampling.crowding != "near" or not config.use_ensemble:
            raise ValueError("the serial search knows crowding 'near' and the ensemble only")
        if config.actions.steer_goal + config.actions.steer_sparse > 0:
            raise ValueError("the serial search does not steer: steer_goal and steer_sparse are 0")
        self.networks, self.config, self.limits = networks, config, limits
        # numpy would round plain floats to float32 before it compares; the kernels do not
        self.radii = Radii(*map(np.float64, astuple(radii)))
        self.goal = goal
        shape = (config.expansions, DIRECTION + networks.action_size)
        self.draws: Float64 = generator("plan", seed).random(shape)
        nodes = min(config.expansions + 1, config.max_nodes or np.inf)
        self.capacity = int(nodes)
        self.latent = np.zeros((len(start), self.capacity), np.float32)
        self.action = np.zeros((self.capacity, networks.action_size), np.float32)
        self.parent = np.full(self.capacity, -1)
        self.depth = np.zeros(self.capacity, np.int64)
        self.crowding = np.zeros(self.capacity, np.int64)
        self.weight = np.ones(self.capacity)
        self.useful = np.ones(self.capacity, np.bool_)
        self.to_goal = np.full(self.capacity, np.inf, np.float32)
        self.children: list[set[int]] = [set()]
        self.latent[:, 0] = start
        self.size, self.nearest = 1, 0
        self.to_goal[0] = np.linalg.norm(start - goal)

    def run(self) -> SerialPlan:
        """Spend the budget of expansions, and return the best path."""
        for draw in self.draws:
            if self.size == self.capacity or not self.useful[: self.size].any():
                break
            self.expand(draw)
            if self.config.prune:
                self._prune()
        return self.best_plan()

    def expand(self, draw: Float64) -> None:
        """Select a node, step from it, test where that leads, insert, rewire; draws [6+A]."""
        parent = self._choose(draw)
        action = self._propose(parent, draw)
        z, variance = self.networks.step(self._latents(parent), action[None])
        gaps = self._gaps(z[0])
        if not self._admissible(parent, z, float(variance[0]), gaps):
            if self.config.sampling.count_rejections:
                self._crowd(np.array([parent]))
            return
        near = np.flatnonzero(gaps <= self.radii.neighbor**2)
        new = self._insert(parent, z[0], action)
        crowded = near[gaps[near] <= self.radii.crowding**2]
        self._crowd(crowded)
        self._crowd(np.array([new]), len(crowded))
        if self.config.rewire.enabled:
            self._rewire(new, near, gaps[near])

    def _choose(self, draw: Float64) -> int:
        """The node to expand: any, a sparse one, or the one nearest to the goal (Sec. 4.3)."""
        config, n = self.config, self.size
        if draw[0] < config.sampling.p_uniform:
            return min(int(draw[1] * n), n - 1)
        if draw[0] < config.sampling.p_uniform + config.sampling.p_sparse:
            total = np.cumsum(np.where(self.useful[:n], self.weight[:n], 0.0))
            return min(int(np.searchsorted(total, draw[1] * total[-1], side="right")), n - 1)
        return self.nearest

    def _propose(self, parent: int, draw: Float64) -> Float32:
        """A uniform action [A], perhaps scaled to the edge of the box, or the node's own onward."""
        config = self.config
        action = (2 * draw[DIRECTION:] - 1).astype(np.float32)
        if draw[2] < config.actions.edge:
            action /= max(np.abs(action).max(), np.float32(1e-6))
        own = self.action[parent]
        if own.any() and draw[3] < config.actions.momentum:
            action = np.clip(own + np.float32(config.actions.momentum_noise) * action, -1, 1)
        return action

    def _latents(self, nodes: int | Int64) -> Float32:
        """Latents [M,Z] of nodes [M]."""
        return np.ascontiguousarray(self.latent[:, np.atleast_1d(nodes)].T)

    def _gaps(self, z: Float32) -> Float32:
        """Squared distances [n] of all nodes to a latent [Z]."""
        step = self.latent[:, : self.size] - z[:, None]
        gaps: Float32 = np.einsum("zn,zn->n", step, step)
        return gaps

    def _admissible(self, parent: int, z: Float32, variance: float, gaps: Float32) -> bool:
        """Whether the step to z [1,Z] passes the tests, the cheap ones first."""
        limits = self.limits
        if not np.isfinite(z).all() or variance > limits.max_variance:
            return False
        cost = self.depth[parent] + 1
        copies = gaps < self.radii.duplicate**2
        if copies.any() and (self.depth[: self.size][copies] <= cost).any():
            return False
        if limits.max_support_distance < np.inf and (
            self.networks.support_distance(z[0]) > limits.max_support_distance
        ):
            return False
        return bool(self._likely(self._latents(parent), z)[0])

    def _likely(self, z: Float32, z_next: Float32) -> Bool:
        """Whether ψ finds transitions [M,Z] -> [M,Z] likely [M]."""
        if self.limits.min_log_density == -np.inf:
            return np.ones(len(z), np.bool_)
        likely: Bool = self.networks.log_density(z, z_next) >= self.limits.min_log_density
        return likely

    def _crowd(self, nodes: Int64, by: int = 1) -> None:
        """Count `by` more at each of the nodes, which are drawn the less for it."""
        self.crowding[nodes] += by
        self.weight[nodes] = (1.0 + self.crowding[nodes]) ** -self.config.sampling.sparse_exponent

    def _insert(self, parent: int, z: Float32, action: Float32) -> int:
        new = self.size
        self.size += 1
        self.latent[:, new], self.action[new] = z, action
        self.parent[new], self.depth[new] = parent, self.depth[parent] + 1
        self.children[parent].add(new)
        self.children.append(set())
        self.to_goal[new] = np.linalg.norm(z - self.goal)
        if self.to_goal[new] < self.to_goal[self.nearest]:
            self.nearest = new
        return new

    def _prune(self) -> None:
        """Note which nodes may still lead to a shorter path than the best there is."""
        n = self.size
        inside = self.to_goal[:n] <= self.radii.goal
        if inside.any():
            ahead = np.ceil((self.to_goal[:n] - self.radii.goal) / self.radii.longest)
            best = self.depth[:n][inside].min()
            self.useful[:n] = self.depth[:n] + np.maximum(ahead, 1) < best

    def _rewire(self, new: int, near: Int64, gaps: Float32) -> None:
        """Hang the new node from the cheapest neighbour, and from it whatever becomes cheaper.

        Neighbours are tried as parents one a round, the cheapest first, until an edge passes the
        tests; from the second round on the new node is offered as a parent, to each once.
        """
        order = np.lexsort((near, gaps, self.depth[near]))
        sources, targets = near[order].tolist(), set(near.tolist())
        for attempt in range(1 + self.config.rewire.candidates):
            edges = []
            if sources and self.depth[sources[0]] + 1 < self.depth[new]:
                edges.append((sources.pop(0), new))
            if attempt:
                cheaper = {j for j in targets if self.depth[new] + 1 < self.depth[j]}
                edges += [(new, j) for j in sorted(cheaper)]
                targets -= cheaper
                if not edges:
                    return
            self._try_edges(edges)

    def _try_edges(self, edges: list[tuple[int, int]]) -> None:
        """Take the edges (from, to) that pass the tests and lower the cost of their end."""
        if not edges:
            return
        ends = np.array(edges)
        action, passed = self._test_edges(self._latents(ends[:, 0]), self._latents(ends[:, 1]))
        for (source, target), way, good in zip(edges, action, passed, strict=True):
            if good and self.depth[source] + 1 < self.depth[target]:
                self._hang(target, source, way)

    def _test_edges(self, z: Float32, z_next: Float32) -> tuple[Float32, Bool]:
        """π's actions [M,A] along edges, and which pass ψ and the round trip through H_f [M]."""
        limits = self.limits
        passed = self._likely(z, z_next)
        action = np.zeros((len(z), self.networks.action_size), np.float32)
        if not passed.any():
            return action, passed
        some = np.flatnonzero(passed)
        action[some] = self.networks.act(z[some], z_next[some])
        if limits.max_round_trip < np.inf:
            landed, variance = self.networks.step(z[some], action[some])
            miss = np.linalg.norm(landed - z_next[some], axis=1)
            passed[some] = (miss <= limits.max_round_trip) & (variance <= limits.max_variance)
        return action, passed

    def _hang(self, node: int, parent: int, action: Float32) -> None:
        """Give a node another parent; the change of its cost goes to all that is below it."""
        self.children[self.parent[node]].remove(node)
        self.children[parent].add(node)
        self.parent[node], self.action[node] = parent, action
        change = self.depth[parent] + 1 - self.depth[node]
        below = [node]
        while below:
            at = below.pop()
            self.depth[at] += change
            below.extend(self.children[at])

    def best_plan(self) -> SerialPlan:
        """The path to the cheapest node within the goal radius, else to the one nearest to it."""
        end, n = self.nearest, self.size
        distance = self.to_goal[:n]
        inside = np.flatnonzero(distance <= self.radii.goal)
        if len(inside):
            end = int(inside[np.lexsort((distance[inside], self.depth[:n][inside]))[0]])
        path = [end]
        while self.parent[path[-1]] >= 0:
            path.append(int(self.parent[path[-1]]))
        nodes = np.array(path[::-1])
        return SerialPlan(self._latents(nodes), self.action[nodes[1:]], bool(len(inside)))


def plan_serially(
    networks: Networks, config: TreeConfig, limits: Limits, radii: Radii, query: Query
) -> SerialPlan:
    """A plan for the only row of a query, one expansion after the other."""
    tree = SerialTree(
        networks,
        config,
        limits,
        radii,
        start=query.start[0],
        goal=query.goal[0],
        seed=int(query.seed[0]),
    )
    return tree.run()
