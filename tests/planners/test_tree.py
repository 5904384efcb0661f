from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners import tree
from elast_cli.planners.tree import NONE, Forest
from elast_cli.shapes import Int32


def planted(rows: int = 1, nodes: int = 8, extra: int = 4) -> Forest:
    start = np.zeros((rows, 2), np.float32)
    goal = np.tile(np.array([3, 4], np.float32), (rows, 1))
    return tree.plant(
        start, np.ones((rows, 1), np.float32), goal, nodes=nodes, extra=extra, actions=1
    )


def insert(forest: Forest, parent: list[int], alive: list[bool] | None = None) -> Int32:
    """Insert candidates below `parent` [K] into a forest of one tree; returns their indices."""
    new = np.empty((1, len(parent)), np.int32)
    tree.insert(
        forest.latent,
        forest.feature,
        forest.action,
        forest.parent,
        forest.depth,
        forest.crowding,
        forest.child,
        forest.after,
        forest.before,
        forest.size,
        np.array([alive or [True] * len(parent)]),
        np.array([parent], np.int32),
        np.ones((1, len(parent), 1), np.float32),
        new,
    )
    inserted: Int32 = new[0]
    return inserted


def rewire(forest: Forest, edges: list[tuple[int, int]]) -> int:
    """Offer edges (from, to) to a forest of one tree; returns how many were taken."""
    return tree.rewire(
        np.array([(0, i, j) for i, j in edges], np.int32).reshape(-1, 3),
        np.full((len(edges), 1), 0.5, np.float32),
        forest.action,
        forest.parent,
        forest.depth,
        forest.child,
        forest.after,
        forest.before,
    )


def assert_sound(forest: Forest, b: int) -> None:
    """Tree b has no cycle, true depths, and child lists that agree with the parents."""
    size = int(forest.size[b])
    parent, depth = forest.parent[b], forest.depth[b]
    assert parent[0] == NONE
    assert depth[0] == 0
    assert (parent[1:size] >= 0).all()
    assert (parent[1:size] < size).all()
    np.testing.assert_array_equal(depth[1:size], depth[parent[1:size]] + 1)  # hence no cycle
    for i in range(size):
        path = tree.path_to(forest, b, i)
        assert path[0] == 0
        assert len(path) == depth[i] + 1
        listed, last, node = [], NONE, int(forest.child[b, i])
        while node != NONE:
            assert forest.before[b, node] == last
            listed.append(node)
            last, node = node, int(forest.after[b, node])
        assert sorted(listed) == np.flatnonzero(parent[:size] == i).tolist()


def test_a_planted_tree_is_its_root() -> None:
    forest = planted(rows=2)
    assert forest.capacity == 8
    assert forest.size.tolist() == [1, 1]
    assert forest.nearest_distance.tolist() == [5, 5]
    assert (forest.feature[:, 0] == 1).all()
    for b in range(2):
        assert_sound(forest, b)


def test_insert_moves_live_candidates_into_the_tree() -> None:
    forest = planted()
    forest.latent[0, 8:11] = [[1, 1], [2, 2], [3, 3]]
    new = insert(forest, [0, 0, 0], [True, False, True])
    assert new.tolist() == [1, NONE, 2]
    assert forest.latent[0, :3].tolist() == [[0, 0], [1, 1], [3, 3]]
    assert forest.depth[0, :3].tolist() == [0, 1, 1]
    assert_sound(forest, 0)


def test_a_full_tree_takes_no_more() -> None:
    forest = planted(nodes=3)
    new = insert(forest, [0, 0, 0, 0])
    assert new.tolist() == [1, 2, NONE, NONE]
    assert forest.size[0] == 3
    assert_sound(forest, 0)


def test_rewiring_carries_the_new_cost_to_the_whole_subtree() -> None:
    forest = planted()
    for parent in (0, 1, 2, 3, 4):  # a chain 0-1-2-3-4-5
        insert(forest, [parent])
    insert(forest, [0])  # 6, beside the chain
    assert rewire(forest, [(6, 3)]) == 1
    assert forest.depth[0, :7].tolist() == [0, 1, 2, 2, 3, 4, 1]
    assert tree.path_to(forest, 0, 5) == [0, 6, 3, 4, 5]
    assert forest.action[0, 3, 0] == 0.5
    assert_sound(forest, 0)


def test_an_edge_that_no_longer_lowers_the_cost_is_not_taken() -> None:
    forest = planted()
    for parent in (0, 1, 2):
        insert(forest, [parent])
    insert(forest, [0, 0])
    assert rewire(forest, [(4, 3), (5, 3), (3, 0), (3, 3)]) == 1
    assert forest.parent[0, 3] == 4
    assert_sound(forest, 0)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_a_tree_stays_sound_under_any_inserts_and_edges(seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    forest = planted(nodes=40, extra=3)
    for _ in range(steps):
        size, before = int(forest.size[0]), forest.depth.copy()
        if rng.random() < 0.5:
            insert(forest, rng.integers(size, size=3).tolist(), (rng.random(3) < 0.7).tolist())
        else:
            rewire(forest, rng.integers(size, size=(8, 2)).tolist())
            assert (forest.depth[0, :size] <= before[0, :size]).all()
        assert_sound(forest, 0)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_nodes_are_chosen_as_often_as_the_biases_say(exponent: float) -> None:
    crowding = np.array([[0, 1, 3, 0, 99]], np.int32)  # the last is beyond the tree's size
    size, nearest = np.array([4]), np.array([2])
    draws = np.random.default_rng(0).random((1, 200_000, 2))
    chosen = np.empty((1, 200_000), np.int32)
    tree.choose(crowding, size, nearest, draws, (0.2, 0.5), exponent, chosen)
    weight = (1.0 + crowding[0, :4]) ** -exponent
    expected = 0.2 / 4 + 0.5 * weight / weight.sum() + 0.3 * (np.arange(4) == 2)
    share = np.bincount(chosen[0], minlength=4) / chosen.size
    np.testing.assert_allclose(share, expected, atol=4 * np.sqrt(0.25 / chosen.size))


def test_the_largest_draw_still_chooses_a_node_of_the_tree() -> None:
    top = np.nextafter(1.0, 0)
    draws = np.array([[[0.0, top], [0.5, top], [top, top]]])
    chosen = np.empty((1, 3), np.int32)
    crowding = np.array([[7, 7, 7, 0]], np.int32)
    tree.choose(crowding, np.array([3]), np.array([1]), draws, (0.3, 0.4), 3.0, chosen)
    assert chosen.tolist() == [[2, 2, 1]]


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(5, 99), st.integers(0, 30), st.integers(1, 30))
def test_neighbors_are_those_that_brute_force_finds(
    seed: int, hundredths: int, closer: int, room: int
) -> None:
    # points on a grid, radii between its distances: no rounding decides
    radius, same = (hundredths + 0.5) / 100, (min(closer, hundredths) + 0.5) / 100
    rng = np.random.default_rng(seed)
    b, n, k = 2, 20, 5
    latent = rng.random((b, n + k, 2), dtype=np.float32).round(2)
    depth = rng.integers(5, size=(b, n)).astype(np.int32)
    new_depth = rng.integers(5, size=(b, k)).astype(np.int32)
    size = rng.integers(1, n, size=b)
    alive = rng.random((b, k)) < 0.8
    expected, dead = [], ~alive
    for row, slot in zip(*np.nonzero(alive), strict=True):
        offset = latent[row, n + slot] - latent[row, : size[row]]
        gap = offset[:, 0] ** 2 + offset[:, 1] ** 2
        if ((gap < same**2) & (depth[row, : size[row]] <= new_depth[row, slot])).any():
            dead[row, slot] = True
        else:
            expected += [(row, slot, j) for j in np.flatnonzero(gap <= radius**2)]
    while True:
        pairs, gaps = np.empty((room, 3), np.int32), np.empty(room, np.float32)
        found = tree.find_neighbors(
            latent, depth, size, n, new_depth, alive, radius, same, pairs, gaps
        )
        if found <= room:
            break
        room = found
    np.testing.assert_array_equal(pairs[:found], np.reshape(expected, (-1, 3)))
    np.testing.assert_array_equal(~alive, dead)
    assert (gaps[:found] <= radius**2).all()


def test_a_costlier_duplicate_of_a_node_is_dropped_and_a_cheaper_one_kept() -> None:
    latent = np.zeros((1, 3, 2), np.float32)
    latent[0, 1:] = 0.01
    alive = np.array([[True, True]])
    pairs, gaps = np.empty((4, 3), np.int32), np.empty(4, np.float32)
    found = tree.find_neighbors(
        latent,
        np.array([[3]], np.int32),
        np.array([1]),
        1,
        np.array([[2, 3]], np.int32),
        alive,
        1.0,
        0.1,
        pairs,
        gaps,
    )
    assert alive.tolist() == [[True, False]]
    assert pairs[:found].tolist() == [[0, 0, 0]]


def test_no_duplicate_radius_means_that_nothing_is_dropped() -> None:
    alive = np.array([[True]])
    found = tree.find_neighbors(
        np.zeros((1, 2, 2), np.float32),  # the candidate lies exactly on the root
        np.array([[0]], np.int32),
        np.array([1]),
        1,
        np.array([[1]], np.int32),
        alive,
        1.0,
        0.0,
        np.empty((1, 3), np.int32),
        np.empty(1, np.float32),
    )
    assert alive.all()
    assert found == 1


def test_the_nearest_node_is_kept_up_to_date() -> None:
    forest = planted()
    before = forest.size.copy()
    forest.latent[0, 8:10] = [[3.0, 3.0], [3.0, 3.5]]
    insert(forest, [0, 0])
    tree.update_nearest(
        forest.latent,
        np.array([[3, 4]], np.float32),
        before,
        forest.size,
        forest.nearest,
        forest.nearest_distance,
    )
    assert forest.nearest.tolist() == [2]
    assert forest.nearest_distance.tolist() == [0.5]
