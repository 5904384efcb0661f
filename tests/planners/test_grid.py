from __future__ import annotations

from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners import grid
from elast_cli.planners.grid import Cells
from elast_cli.planners.neighbors import any_within, drop_copies, find_pairs
from elast_cli.shapes import Float32, Int64


class Crowd(NamedTuple):
    """Points of two rows in their cells, and queries."""

    cells: Cells
    points: Float32
    size: Int64
    queries: Float32


def crowd(seed: int, dimensions: int, side: float, spread: float = 1.0) -> Crowd:
    """Points and queries on a grid of hundredths, so that no rounding decides who is near."""
    rng = np.random.default_rng(seed)
    points = (spread * rng.random((2, 60, dimensions))).round(2).astype(np.float32)
    queries = (spread * rng.random((2, 5, dimensions))).round(2).astype(np.float32)
    size = rng.integers(1, 60, size=2)
    axes = grid.principal_axes(points[0])
    found = grid.empty_cells(2, 60, axes=axes, side=side)
    half = size // 2
    grid.add(found, points, np.zeros(2, np.int64), half)
    grid.add(found, points, half, size)
    return Crowd(found, points, size, queries)


def gap(query: Float32, points: Float32) -> Float32:
    """Distances [N] between hundredths."""
    found: Float32 = np.sqrt(((query.astype(np.float64) - points) ** 2).round(4).sum(1))
    return found


seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 6)
radii = st.integers(0, 99).map(lambda hundredths: (hundredths + 0.005) / 100)
sides = st.sampled_from([0.05, 0.3, 2.0])
many = settings(deadline=None, max_examples=80)


@many
@given(seeds, sizes, radii, sides, st.integers(1, 40))
def test_pairs_are_those_that_brute_force_finds(
    seed: int, dimensions: int, radius: float, side: float, room: int
) -> None:
    found, points, size, queries = crowd(seed, dimensions, side)
    wanted = np.random.default_rng(seed).random((2, 5)) < 0.8
    rows = np.array([1, 0])
    expected = {
        (rows[r], k, j)
        for r, k in zip(*np.nonzero(wanted), strict=True)
        for j in np.flatnonzero(gap(queries[r, k], points[rows[r], : size[rows[r]]]) <= radius)
    }
    while True:
        pairs, gaps = np.empty((3, room), np.int32), np.empty(room, np.float32)
        count = find_pairs(found, rows, queries, wanted, radius, pairs, gaps)
        if count <= room:
            break
        room = count
    assert count == len(expected)
    assert set(zip(*pairs[:, :count].tolist(), strict=True)) == expected
    r, k, j = pairs[:, :count]
    true = ((queries[1 - r, k] - points[r, j]) ** 2).sum(-1)  # rows are 1, 0
    np.testing.assert_allclose(gaps[:count], true, atol=1e-5)


@many
@given(seeds, sizes, radii, sides)
def test_copies_of_no_costlier_points_are_dropped(
    seed: int, dimensions: int, radius: float, side: float
) -> None:
    found, points, size, queries = crowd(seed, dimensions, side, spread=0.5)
    rng = np.random.default_rng(seed)
    cost, new_cost = (rng.integers(4, size=s).astype(np.int32) for s in ((2, 60), (2, 5)))
    wanted = np.ones((2, 5), np.bool_)
    drop_copies(found, np.arange(2), queries, wanted, radius, cost, new_cost)
    for b in range(2):
        for k in range(5):
            near = gap(queries[b, k], points[b, : size[b]]) < radius
            assert wanted[b, k] == (not (near & (cost[b, : size[b]] <= new_cost[b, k])).any())


def test_no_radius_means_that_nothing_is_dropped() -> None:
    found = grid.empty_cells(1, 1, axes=np.eye(2), side=1.0)
    point = np.zeros((1, 1, 2), np.float32)
    grid.add(found, point, np.array([0]), np.array([1]))
    wanted, cost = np.array([[True]]), np.zeros((1, 1), np.int32)
    drop_copies(found, np.arange(1), point, wanted, 0.0, cost, cost)
    assert wanted.all()


@many
@given(seeds, sizes, radii, sides)
def test_any_within_is_what_the_nearest_says(
    seed: int, dimensions: int, radius: float, side: float
) -> None:
    found, points, size, queries = crowd(seed, dimensions, side)
    expected = [gap(query, points[0, : size[0]]).min() <= radius for query in queries[0]]
    assert any_within(found, queries[0], radius).tolist() == expected


def test_cells_reach_far_and_to_negative_places() -> None:
    points = np.array([[[-1e6, 0], [1e6, -3], [-1e6, 0.5]]], np.float32)
    found = grid.empty_cells(1, 3, axes=np.eye(2), side=0.1)
    grid.add(found, points, np.array([0]), np.array([3]))
    pairs, gaps = np.empty((3, 9), np.int32), np.empty(9, np.float32)
    wanted = np.array([[True, True]])
    queries = np.ascontiguousarray(points[:, :2])
    count = find_pairs(found, np.arange(1), queries, wanted, 1.0, pairs, gaps)
    assert sorted(zip(*pairs[1:, :count].tolist(), strict=True)) == [(0, 0), (0, 2), (1, 1)]


def test_principal_axes_are_those_of_the_widest_spread() -> None:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((500, 4), dtype=np.float32) * np.array([1, 9, 0.1, 3], np.float32)
    axes = grid.principal_axes(points)
    np.testing.assert_allclose(axes.T @ axes, np.eye(2), atol=1e-12)
    assert np.abs(axes).argmax(0).tolist() == [1, 3]
    assert grid.principal_axes(points[:, :1]).shape == (1, 1)
