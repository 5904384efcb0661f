from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners.grid import NONE
from elast_cli.planners.tree.edges import edges_around, pick
from elast_cli.planners.tree.forest import Forest, path_to, plant
from elast_cli.planners.tree.forest import insert as forest_insert
from elast_cli.planners.tree.forest import rewire as forest_rewire
from elast_cli.shapes import Int32
from tests.toys.trees import assert_sound


def planted(rows: int = 1, nodes: int = 8, extra: int = 4) -> Forest:
    start = np.zeros((rows, 2), np.float32)
    goal = np.tile(np.array([3, 4], np.float32), (rows, 1))
    return plant(start, np.ones((rows, 1), np.float32), goal, nodes=nodes, extra=extra, actions=1)


def insert(
    forest: Forest,
    parent: list[int],
    alive: list[bool] | None = None,
    latent: list[list[float]] | None = None,
) -> Int32:
    """Insert candidates below `parent` [K] into a forest of one tree; returns their indices."""
    k = len(parent)
    index: Int32 = forest_insert(
        forest,
        np.zeros(1, np.int64),
        np.array([latent or [[0, 0]] * k], np.float32),
        np.array([alive or [True] * k]),
        np.array([parent], np.int32),
        np.ones((1, k, 1), np.float32),
    )
    inserted: Int32 = index[0]
    return inserted


def edges_of(edges: list[tuple[int, int]]) -> tuple[Int32, Int32, Int32]:
    """Rows, sources and targets [P] of edges (from, to) in a forest of one tree."""
    row, source, target = np.array([(0, i, j) for i, j in edges], np.int32).reshape(-1, 3).T.copy()
    return row, source, target


def rewire(forest: Forest, edges: list[tuple[int, int]]) -> int:
    """Offer edges (from, to) to a forest of one tree; returns how many were taken."""
    action, admissible = np.full((len(edges), 1), 0.5, np.float32), np.ones(len(edges), np.bool_)
    taken: int = forest_rewire(forest, *edges_of(edges), action, admissible)
    return taken


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
    new = insert(forest, [0, 0, 0], [True, False, True], [[1, 1], [2, 2], [3, 3]])
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
    assert path_to(forest, 0, 5) == [0, 6, 3, 4, 5]
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


def test_the_nearest_node_is_kept_up_to_date() -> None:
    forest = planted()
    insert(forest, [0, 0], latent=[[3.0, 3.0], [3.0, 3.5]])
    assert forest.nearest.tolist() == [2]
    assert forest.nearest_distance.tolist() == [0.5]


def test_the_cheapest_edge_into_each_node_is_picked_then_the_shortest() -> None:
    forest = planted()
    for parent in (0, 1, 2, 3):  # a chain 0-1-2-3-4
        insert(forest, [parent])
    insert(forest, [0, 0])  # 5 and 6
    edges = np.stack(edges_of([(1, 4), (5, 4), (6, 4), (0, 4), (0, 3), (3, 4)]))
    gap = np.array([3, 1, 2, 9, 1, 1], np.float32)
    untried = np.ones(6, np.bool_)

    def picked() -> list[tuple[int, int]]:
        _, source, target = pick(forest, edges, gap, untried)
        return list(zip(source.tolist(), target.tolist(), strict=True))

    assert picked() == [(0, 4), (0, 3)]  # the root is the cheapest source, however far
    assert picked() == [(5, 4)]  # then the shortest of three that cost the same
    assert picked() == [(6, 4)]
    assert picked() == [(1, 4)]
    assert picked() == []  # 3-4 is an edge of the tree and lowers nothing
    assert (forest.offer[0, : forest.size[0]] == NONE).all()


def test_an_edge_that_failed_a_test_is_not_taken() -> None:
    forest = planted()
    for parent in (0, 1, 2):
        insert(forest, [parent])
    action = np.full((1, 1), 0.5, np.float32)
    assert forest_rewire(forest, *edges_of([(0, 3)]), action, np.zeros(1, np.bool_)) == 0
    assert forest.parent[0, 3] == 2


def test_edges_around_new_nodes_lead_in_and_out_again() -> None:
    pairs = np.array([[0, 1, 1], [0, 0, 1], [4, 5, 6]], np.int32)  # row, candidate, node
    index = np.array([[7, NONE], [NONE, 9]], np.int32)
    edges, gap = edges_around(pairs, np.array([0.1, 0.2, 0.3], np.float32), index, 50)
    assert edges.tolist() == [[0, 1, 0, 1], [4, 6, 7, 9], [7, 9, 4, 6]]
    np.testing.assert_allclose(gap, [0.1, 0.3, 0.1, 0.3])


def test_edges_between_mates_lead_where_both_went() -> None:
    pairs = np.array([[0, 0, 0], [1, 2, 2], [50, 50, 51]], np.int32)  # row, candidate, 50 + mate
    index = np.array([[7, NONE, 8]], np.int32)
    edges, gap = edges_around(pairs, np.array([0.1, 0.2, 0.3], np.float32), index, 50)
    assert edges.tolist() == [[0, 0], [7, 8], [8, 7]]
    np.testing.assert_allclose(gap, [0.2, 0.2])
