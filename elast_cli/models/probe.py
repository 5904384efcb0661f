"""Probes: how much of the true state a latent holds. For measurement only, not for training."""

from __future__ import annotations

import numpy as np

from elast_cli.shapes import Float32, Int64

PROBE_ROWS = 5_000
NEIGHBORS = 5


def probe_state(z: Float32, state: Float32, train: Int64, val: Int64) -> dict[str, float]:
    """Errors of reading the true state [N,S] off latents [N,Z] on held-out rows.

    A linear (ridge) probe understates curved latents badly, so a 5-nearest-neighbour probe stands
    beside it. Errors are root mean squares in the state's own units, averaged over its entries.

    Args:
        z: f32 [N,Z].
        state: f32 [N,S].
        train: rows to fit on, i64.
        val: rows to measure on, i64.

    Returns:
        RMSE and R² of both probes, by name.
    """
    from scipy.spatial import cKDTree

    train, val = _thin(train, 4 * PROBE_ROWS), _thin(val, PROBE_ROWS)
    x, y = z[train].astype(np.float64), state[train].astype(np.float64)
    center, spread = x.mean(0), x.std(0) + 1e-9
    design = np.c_[(x - center) / spread, np.ones(len(x))]
    weights = np.linalg.solve(design.T @ design + 1e-3 * np.eye(design.shape[1]), design.T @ y)
    linear = np.c_[(z[val] - center) / spread, np.ones(len(val))] @ weights
    few = np.arange(min(NEIGHBORS, len(train))) + 1
    _, neighbors = cKDTree(z[train]).query(z[val], k=few)
    nearest = y[neighbors].mean(1)
    variance = max(float(state[val].var(0).mean()), 1e-12)
    return {
        "probe_linear_rmse": _rmse(linear, state[val]),
        "probe_linear_r2": 1 - float(np.square(linear - state[val]).mean()) / variance,
        "probe_knn_rmse": _rmse(nearest, state[val]),
        "probe_knn_r2": 1 - float(np.square(nearest - state[val]).mean()) / variance,
    }


def _thin(rows: Int64, most: int) -> Int64:
    return rows[:: max(1, len(rows) // most)][:most]


def thinned(rows: Int64, most: int) -> Int64:
    """All of some rows, or at most `most` of them, evenly spaced."""
    return rows[:: max(1, -(-len(rows) // most))]


def _rmse(predicted: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.square(predicted - truth).mean()))
