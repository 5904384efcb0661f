from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners.tree import selection
from elast_cli.planners.tree.selection import Sparsity
from elast_cli.seeding import generator
from elast_cli.shapes import Float64, Int32

ROWS = np.zeros(1, np.int64)


def sparsity_of(rows: int, nodes: int, exponent: float) -> Sparsity:
    """Of `nodes` that nothing crowds."""
    found = Sparsity(
        selection.no_weights(rows, nodes),
        np.zeros((rows, nodes), np.int32),
        selection.weight_table(exponent),
    )
    selection.admit(found, np.zeros(rows, np.int64), np.full(rows, nodes))
    return found


def sums_of(crowding: list[int], exponent: float) -> Float64:
    """Sums over one row whose nodes are crowded so."""
    sparsity = sparsity_of(1, len(crowding), exponent)
    crowd(sparsity, np.repeat(np.arange(len(crowding), dtype=np.int32), crowding))
    assert sparsity.crowding[0].tolist() == crowding
    return sparsity.sums


def crowd(sparsity: Sparsity, node: Int32) -> None:
    """Count one more at each node [M] of one row."""
    edges = np.stack([np.zeros_like(node), node, node])
    selection.crowd_along(sparsity, edges, np.zeros(len(node), np.float32), 0.0)


def choose(sums: Float64, size: int, draws: Float64, shares: tuple[float, float]) -> Int32:
    """Nodes of one row [K]; the node nearest to the goal is node 2."""
    chosen: Int32 = selection.choose(sums, ROWS, np.array([size]), np.array([2]), draws, shares)[0]
    return chosen


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_nodes_are_chosen_as_often_as_the_biases_say(exponent: float) -> None:
    crowding = np.array([0, 1, 3, 0])
    sums = sums_of(crowding.tolist(), exponent)
    draws = np.random.default_rng(0).random((1, 200_000, 2))
    chosen = choose(sums, 4, draws, (0.2, 0.5))
    weight = (1.0 + crowding) ** -exponent
    expected = 0.2 / 4 + 0.5 * weight / weight.sum() + 0.3 * (np.arange(4) == 2)
    share = np.bincount(chosen, minlength=4) / chosen.size
    np.testing.assert_allclose(share, expected, atol=4 * np.sqrt(0.25 / chosen.size))


def test_the_largest_draw_still_chooses_a_node_of_the_tree() -> None:
    top = np.nextafter(1.0, 0)
    draws = np.array([[[0.0, top], [0.5, top], [top, top]]])
    assert choose(sums_of([7, 7, 7], 3.0), 3, draws, (0.3, 0.4)).tolist() == [2, 2, 2]


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 60), min_size=1, max_size=40), st.floats(0, 4))
def test_shares_of_the_line_are_those_of_the_weights(crowding: list[int], exponent: float) -> None:
    sums = sums_of(crowding, exponent)
    weight = (1.0 + np.array(crowding)) ** -exponent
    np.testing.assert_allclose(sums[0, 1], weight.sum())
    ends = np.cumsum(weight) / weight.sum()
    middles = ends - weight / weight.sum() / 2
    draws = np.stack([np.zeros_like(middles), middles], -1)[None]
    assert choose(sums, len(crowding), draws, (0.0, 1.0)).tolist() == list(range(len(crowding)))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_sums_depend_on_the_weights_and_not_on_their_history(seed: int) -> None:
    rng = np.random.default_rng(seed)
    node = rng.integers(9, size=50).astype(np.int32)
    found = []
    for order in (node, rng.permutation(node)):
        sparsity = sparsity_of(1, 9, 3.0)
        crowd(sparsity, order)
        found.append(sparsity.sums)
    np.testing.assert_array_equal(found[0], found[1])


def test_only_short_edges_and_rejections_crowd() -> None:
    sparsity = sparsity_of(2, 3, 1.0)
    edges = np.array([[0, 0, 1], [1, 2, 0], [0, 0, 2]], np.int32)
    selection.crowd_along(sparsity, edges, np.array([4, 5, 4], np.float32), 4.0)
    assert sparsity.crowding.tolist() == [[0, 1, 0], [1, 0, 0]]
    alive, parent = np.array([[True, False]]), np.array([[0, 2]], np.int32)
    selection.crowd_rejected(sparsity, np.array([1]), alive, parent)
    assert sparsity.crowding.tolist() == [[0, 1, 0], [1, 0, 1]]
    assert sparsity.sums[:, 1].tolist() == [2.5, 2.0]


def test_a_node_without_weight_stays_so_however_crowded() -> None:
    sparsity = sparsity_of(1, 2, 1.0)
    selection.set_weight(sparsity.sums[0], 1, 0.0)
    crowd(sparsity, np.array([0, 1], np.int32))
    assert (sparsity.crowding.tolist(), sparsity.sums[0, 1]) == ([[1, 1]], 0.5)


@settings(deadline=None, max_examples=20)
@given(st.lists(st.integers(1, 3 * selection.BLOCK // 2), min_size=1, max_size=6))
def test_random_numbers_do_not_depend_on_how_they_are_taken(counts: list[int]) -> None:
    draws = selection.Draws(np.array([5, 6]), 3)
    found = np.concatenate([draws.take(count) for count in counts], axis=1)
    for b, seed in enumerate((5, 6)):
        np.testing.assert_array_equal(found[b], generator("plan", seed).random((found.shape[1], 3)))


def test_no_crowding_takes_the_whole_weight_of_a_node() -> None:
    weights = selection.weight_table(400.0)
    assert (weights > 0).all()
    assert (np.diff(weights) <= 0).all()
    sums = sums_of([9, 50], 400.0)
    assert (sums[0, sums.shape[1] // 2 :][:2] > 0).all()
    draws = np.array([[[0.0, 0.1], [0.0, 0.9]]])
    assert choose(sums, 2, draws, (0.0, 1.0)).tolist() == [0, 1]
