from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners.tree import siblings
from elast_cli.shapes import Bool, Float32

CAPACITY = 100
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 9)
radii = st.integers(0, 99).map(lambda hundredths: (hundredths + 0.005) / 100)
many = settings(deadline=None, max_examples=80)


def batch(seed: int, size: int) -> tuple[Float32, Bool]:
    """Candidates of two rows on a grid of hundredths, and which of them are alive."""
    rng = np.random.default_rng(seed)
    latent = (0.5 * rng.random((2, 20, size))).round(2).astype(np.float32)
    return latent, rng.random((2, 20)) < 0.8


def gaps_between(latent: Float32) -> Float32:
    """Distances [K,K] between hundredths [K,Z]."""
    step = latent[:, None].astype(np.float64) - latent
    found: Float32 = np.sqrt((step**2).round(4).sum(2))
    return found


@many
@given(seeds, sizes, radii)
def test_of_copies_that_are_no_cheaper_the_first_wins(seed: int, size: int, radius: float) -> None:
    latent, alive = batch(seed, size)
    cost = np.random.default_rng(seed).integers(3, size=(2, 20)).astype(np.int32)
    expected = alive.copy()
    for r in range(2):
        gap = gaps_between(latent[r])
        for k in range(20):
            before = expected[r, :k] & (cost[r, :k] <= cost[r, k])
            expected[r, k] &= not (before & (gap[k, :k] < radius)).any()
    siblings.drop_copies(latent, alive, cost, radius)
    np.testing.assert_array_equal(alive, expected)


@many
@given(seeds, sizes, radii, st.integers(1, 40))
def test_every_two_mates_within_the_radius_are_written_once(
    seed: int, size: int, radius: float, room: int
) -> None:
    latent, alive = batch(seed, size)
    rows = np.array([4, 2])
    expected = []
    for r in range(2):
        near = np.tril(gaps_between(latent[r]) <= radius, -1) & alive[r] & alive[r][:, None]
        expected += [(rows[r], k, CAPACITY + j) for k, j in zip(*np.nonzero(near), strict=True)]
    while True:
        pairs, gaps = np.full((3, room), 7, np.int32), np.zeros(room, np.float32)
        found = siblings.add_pairs(rows, latent, alive, radius, CAPACITY, pairs, gaps, 1)
        if found <= room:
            break
        room = found
    assert list(zip(*pairs[:, 1:found].tolist(), strict=True)) == expected
    assert pairs[:, 0].tolist() == [7, 7, 7]  # what was there stays
    row, k, j = pairs[:, 1:found]
    own = (row != rows[0]).astype(np.int64)
    true = ((latent[own, k] - latent[own, j - CAPACITY]) ** 2).sum(-1)
    np.testing.assert_allclose(gaps[1:found], true, atol=1e-5)


def test_no_radius_means_that_no_mate_is_dropped() -> None:
    alive = np.ones((1, 3), np.bool_)
    siblings.drop_copies(np.zeros((1, 3, 2), np.float32), alive, np.zeros((1, 3), np.int32), 0.0)
    assert alive.all()
