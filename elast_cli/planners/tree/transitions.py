"""The tests that a transition must pass to become an edge (Sec. 4.3), and what they cost."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from elast_cli.planners.base import Limits, PlanCost, World
from elast_cli.planners.tree.edges import count, flat, lands
from elast_cli.planners.tree.forest import Forest
from elast_cli.planners.tree.reuse import closed
from elast_cli.shapes import Bool, Float32, Int32, Int64


class Transitions:
    """Predictions and tests of transitions in the scenarios of one search.

    Attributes:
        world: the learned world of these scenarios.
        limits: thresholds.
        failed: transitions [M,2,Z] that failed in execution, by row.
        failure_radius: how far about such a transition places are closed.
        cost: counts the calls of networks.
    """

    def __init__(
        self,
        world: World,
        limits: Limits,
        failed: Mapping[int, Float32],
        failure_radius: float,
        cost: PlanCost,
    ) -> None:
        """Take the world and the tests; every later call is counted in `cost`.

        Args:
            world: H_f, ψ, support and π of B scenarios.
            limits: thresholds of the tests.
            failed: f32 [M,2,Z] by row; rows without failures are left out.
            failure_radius: in latent units.
            cost: of the B rows, changed in place.
        """
        self.world, self.limits, self.cost = world, limits, cost
        self.failed, self.failure_radius = failed, failure_radius

    @property
    def asks_density(self) -> bool:
        """Whether ψ can reject anything."""
        return self.limits.min_log_density > -np.inf

    def predict(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Bool]:
        """Where actions lead from z: [M,Z], and whether that is sure, finite and not closed [M].

        Args:
            z: latents f32 [M,Z].
            action: f32 [M,A].
            row: scenario of each item, i64 [M].

        Returns:
            f32 [M,Z] and bool [M].
        """
        z_new, variance = self.world.step(z, action, row)
        count(self.cost.transitions, row, self.world.members)
        sure = np.isfinite(z_new).all(-1) & (variance <= self.limits.max_variance)
        if self.failed:
            sure &= ~self.closed(z_new, row)
        return z_new, sure

    def supported(self, z: Float32) -> Bool:
        """Whether latents [M,Z] lie within the data's support [M]."""
        limit = self.limits.max_support_distance
        return self.world.supported(z, limit) if limit < np.inf else np.ones(len(z), np.bool_)

    def likely(
        self, forest: Forest, row: Int64 | Int32, source: Int32, target: Int64 | Int32
    ) -> Bool:
        """Whether ψ finds edges (row, source, target) [P] of a forest likely: [P].

        Args:
            forest: the trees, for their features.
            row: tree of each edge, i64 or i32 [P].
            source: i32 [P].
            target: i64 or i32 [P]; slots from N on are candidates.

        Returns:
            bool [P].
        """
        table = forest.feature.reshape(-1, forest.feature.shape[2])
        width = forest.feature.shape[1]
        here, there = flat(row, source, target, width, self.cost.density_calls)
        likely: Bool = self.world.log_density(table, here, there) >= self.limits.min_log_density
        return likely

    def likely_from(self, b: int, feature: Float32, others: Float32) -> Bool:
        """Whether ψ finds it likely to go from a node of row b to others: [E], [P,E] -> [P].

        Args:
            b: row of all nodes.
            feature: of the node, f32 [E].
            others: features of the other nodes, f32 [P,E].

        Returns:
            bool [P].
        """
        if not self.asks_density or not len(others):
            return np.ones(len(others), np.bool_)
        table = np.concatenate([feature[None], others])
        here = np.zeros(len(others), np.int64)
        log_density = self.world.log_density(table, here, here + np.arange(1, len(table)))
        self.cost.density_calls[b] += len(others)
        likely: Bool = log_density >= self.limits.min_log_density
        return likely

    def closed(self, z: Float32, row: Int64) -> Bool:
        """Which places [M,Z] execution could not get to [M]."""
        out = np.zeros(len(row), np.bool_)
        for b, failed in self.failed.items():
            at = np.flatnonzero(row == b)
            out[at] = closed(z[at], failed, self.failure_radius)
        return out

    def round_trip(self, z: Float32, z_next: Float32, row: Int64) -> tuple[Float32, Bool]:
        """π's action from z to z' [M,A], and whether H_f under it surely leads there [M].

        Args:
            z: latents f32 [M,Z].
            z_next: z', latents f32 [M,Z].
            row: scenario of each item, i64 [M].

        Returns:
            f32 [M,A] and bool [M].
        """
        limits = self.limits
        action = self.world.act(z, z_next, row)
        count(self.cost.policy_calls, row, 1)
        if limits.max_round_trip < np.inf:
            landed, variance = self.world.step(z, action, row)
            count(self.cost.transitions, row, self.world.members)
            bounds = (limits.max_round_trip, limits.max_variance)
            admissible = lands(landed, z_next, variance, *bounds)
        else:
            admissible = np.ones(len(row), np.bool_)
        if self.failed:
            admissible &= ~self.closed(z_next, row)
        return action, admissible
