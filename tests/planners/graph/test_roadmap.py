"""Maps of states: which nodes and edges there are, and shortest paths on them by hand."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.planners.graph.roadmap import TIE, Roadmap, merged, roadmap, shortest_from
from elast_cli.shapes import Float32
from tests.toys.dynamics import array

LINE = array([[0, 0], [1, 0], [2, 0], [3, 0], [3.1, 0]])


def edges(found: Roadmap) -> set[tuple[int, int]]:
    return set(zip(found.source.tolist(), found.target.tolist(), strict=True))


def test_states_near_an_earlier_node_become_a_part_of_it() -> None:
    nodes, node_of = merged(LINE, 0.2)
    assert nodes.tolist() == [0, 1, 2, 3]
    assert node_of.tolist() == [0, 1, 2, 3, 3]
    assert merged(LINE, 1.05)[1].tolist() == [0, 0, 1, 1, 2]
    assert merged(LINE, 0.0)[0].tolist() == [0, 1, 2, 3, 4]


def test_pairs_within_the_radius_are_joined_both_ways() -> None:
    found = roadmap(LINE, np.arange(0, 10, 2), spacing=0.2, radius=1.5)
    assert edges(found) == {(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)}
    assert not found.observed.any()
    np.testing.assert_allclose(found.length, 1)
    assert (np.diff(found.source) >= 0).all()
    assert found.first.tolist() == [0, 1, 3, 5, 6]
    assert found.near(array([1.2, 0])).tolist() == [0, 1, 2]


def test_an_observed_transition_is_an_edge_one_way_however_long() -> None:
    rows = np.array([4, 5, 9, 20, 21])  # 0 -> 1 and 3 -> 4 were seen, and 4 is a part of 3
    found = roadmap(LINE, rows, spacing=0.2, radius=0.5)
    assert edges(found) == {(0, 1)}
    assert found.observed.tolist() == [True]
    both = roadmap(LINE, rows, spacing=0.2, radius=1.5)
    seen = [e for e, known in zip(sorted(edges(both)), both.observed, strict=True) if known]
    assert seen == [(0, 1)]


def test_fewest_steps_win_and_then_the_least_length() -> None:
    """By hand: 0 -> 3 in two steps by 1, which bends, or by 2, which does not; 4 takes three."""
    latents = array([[0, 0], [1, 0.8], [1, 0.1], [2, 0], [0.5, 0]])
    found = roadmap(latents, np.arange(5) * 2, spacing=0.0, radius=1.4)
    everything = np.ones(len(found.source), np.bool_)
    start = np.array([0])
    paths = shortest_from(found, everything, start, array([0.7]))
    assert paths.to(3) == [0, 2, 3]
    length = 0.7 + 2 * np.hypot(1, 0.1)
    assert paths.cost[3] == pytest.approx(3 + TIE * length / 1.4)
    without = everything & ~((found.source == 2) & (found.target == 3))
    assert shortest_from(found, without, start, array([0.7])).to(3) == [0, 1, 3]


def test_what_no_usable_edge_leads_to_costs_infinitely_much() -> None:
    found = roadmap(LINE, np.arange(0, 10, 2), spacing=0.2, radius=1.5)
    nothing = np.zeros(len(found.source), np.bool_)
    cost = shortest_from(found, nothing, np.array([1]), array([1.0])).cost
    assert np.isfinite(cost).tolist() == [False, True, False, False]


def test_costs_agree_with_a_plain_breadth_first_search() -> None:
    rng = np.random.default_rng(0)
    latents: Float32 = rng.uniform(-1, 1, (80, 2)).astype(np.float32)
    found = roadmap(latents, np.arange(80) * 2, spacing=0.05, radius=0.3)
    usable = rng.random(len(found.source)) < 0.5
    paths = shortest_from(found, usable, np.array([0]), np.zeros(1, np.float32))
    steps = {0: 1}
    frontier = [0]
    for i in frontier:
        for e in np.flatnonzero(usable & (found.source == i)):
            if (j := int(found.target[e])) not in steps:
                steps[j] = steps[i] + 1
                frontier.append(j)
    for node in range(len(found.latents)):
        assert np.isfinite(paths.cost[node]) == (node in steps)
        if node in steps:
            assert len(paths.to(node)) == steps[node]
            assert int(paths.cost[node]) == steps[node]
