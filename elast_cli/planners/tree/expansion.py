"""Tree expansion: choose nodes and actions, predict, and test (Sec. 4.3, Fig. 4 a, b)."""

from __future__ import annotations

import numpy as np

from elast_cli.planners import neighbors
from elast_cli.planners.tree import selection, siblings
from elast_cli.planners.tree.actions import propose
from elast_cli.planners.tree.edges import count, lengths
from elast_cli.planners.tree.growth import Batch, Growth
from elast_cli.shapes import Float32, Float64, Int64


def expanded(growth: Growth, rows: Int64, draws: Float64) -> Batch:
    """Candidates in the trees of `rows` [R], tested; from random numbers [R,K,6+A] in [0, 1).

    Args:
        growth: the trees and what they grow by; network calls are counted in it.
        rows: trees to expand, i64 [R].
        draws: f64 [R,K,6+A] in [0, 1); K nodes of each tree are expanded.
    """
    batch = _proposed(growth, rows, draws)
    _test(growth, batch)
    return batch


def _proposed(growth: Growth, rows: Int64, draws: Float64) -> Batch:
    """Choose nodes to expand and actions, and predict where they lead."""
    config, forest = growth.config, growth.forest
    shares = (config.sampling.p_uniform, config.sampling.p_sparse)
    sums = growth.sparsity.sums
    parent = selection.choose(sums, rows, forest.size, forest.nearest, draws, shares)
    actions = config.actions
    z, action = propose(
        forest, rows, parent, draws, actions.edge, actions.momentum, actions.momentum_noise
    )
    row = np.repeat(rows, parent.shape[1])
    if actions.steer_goal + actions.steer_sparse > 0:
        _steer(growth, z, action.reshape(len(row), -1), row, draws.reshape(len(row), -1))
    z_new, sure = growth.transitions.predict(z, action.reshape(len(row), -1), row)
    shape = parent.shape
    return Batch(rows, parent, action, z_new.reshape(*shape, -1), sure.reshape(shape))


def _steer(growth: Growth, z: Float32, action: Float32, row: Int64, draws: Float64) -> None:
    """Let π choose some of the actions [M,A] at nodes z [M,Z], from draws [M,6+A]."""
    config, forest, reach = growth.config.actions, growth.forest, growth.radii.neighbor
    chance = draws[:, 4]
    steered = chance < config.steer_goal + config.steer_sparse
    target = forest.goal[row[steered]]
    for m in np.flatnonzero(chance[steered] >= config.steer_goal):
        b, where = row[steered][m], draws[steered, 5][m]
        target[m] = forest.latent[b, selection.draw(growth.sparsity.sums[b], where)]
    here = z[steered]
    step = target - here
    step *= np.minimum(1, reach / np.maximum(lengths(step), 1e-9))[:, None]
    transitions = growth.transitions
    action[steered] = transitions.world.act(here, here + step, row[steered])
    count(transitions.cost.policy_calls, row[steered], 1)


def _test(growth: Growth, batch: Batch) -> None:
    """Clear `alive` where a candidate copies a node or fails a test; cheap tests come first.

    Siblings are compared last, so that no candidate gives way to one that is not inserted.
    """
    forest, transitions, alive = growth.forest, growth.transitions, batch.alive
    duplicate = growth.radii.duplicate
    cost = forest.depth[batch.rows[:, None], batch.parent] + 1
    neighbors.drop_copies(
        growth.cells, batch.rows, batch.latent, alive, duplicate, forest.depth, cost
    )
    r, k = np.nonzero(alive)
    z = batch.latent[r, k]
    passed = transitions.supported(z)
    alive[r, k] = passed
    r, k, z = r[passed], k[passed], z[passed]
    row, slot = batch.rows[r], k + forest.capacity
    forest.feature[row, slot] = transitions.world.features(z, row)
    if transitions.asks_density:
        alive[r, k] = transitions.likely(forest, row, batch.parent[r, k], slot)
    siblings.drop_copies(batch.latent, alive, cost, duplicate)
