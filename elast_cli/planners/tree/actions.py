"""Random actions at the nodes to expand."""

from __future__ import annotations

import numpy as np

from elast_cli.compiled import njit
from elast_cli.planners.tree.forest import Forest
from elast_cli.shapes import Float32, Float64, Int32, Int64

DIRECTION = 6  # where in a candidate's random numbers those of its direction begin


@njit(nogil=True)
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
    size, noise, one = forest.action.shape[2], np.float32(momentum_noise), np.float32(1)
    action = np.empty((*parent.shape, size), np.float32)
    z = np.empty((parent.size, forest.latent.shape[2]), np.float32)
    for r in range(parent.shape[0]):
        for k in range(parent.shape[1]):
            own, new = forest.action[rows[r], parent[r, k]], action[r, k]
            z[r * parent.shape[1] + k] = forest.latent[rows[r], parent[r, k]]
            reach, moved = np.float32(1e-6), False
            for d in range(size):
                new[d] = np.float32(2 * draws[r, k, DIRECTION + d] - 1)
                reach = max(reach, abs(new[d]))
                moved |= own[d] != 0
            if draws[r, k, 2] < edge_actions:
                new /= reach
            if moved and draws[r, k, 3] < momentum:
                for d in range(size):
                    new[d] = min(max(own[d] + noise * new[d], -one), one)
    return z, action
