"""Searches on the toy world: their configuration, their limits, and what a sound tree is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from elast_cli.planners.base import Limits, Query, Radii
from elast_cli.planners.grid import NONE
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.planners.tree.forest import Forest, path_to
from elast_cli.planners.tree.search import ElastPlanner, Search
from elast_cli.shapes import Int64
from tests.toys.box import REACH, Box

LIMITS = Limits(
    min_log_density=-1.0, max_variance=1e-3, max_support_distance=1e-3, max_round_trip=1e-3
)
RADII = Radii(neighbor=0.2, goal=0.1, crowding=0.1, duplicate=0.0)


def tree_config(**changes: Any) -> TreeConfig:
    """A configuration with some keys changed; `batch__min=1` is the key `batch.min`."""
    nested: dict[str, Any] = {}
    for name, value in changes.items():
        *above, key = name.split("__")
        within = nested
        for part in above:
            within = within.setdefault(part, {})
        within[key] = value
    return TreeConfig.model_validate(nested)


def _shares_fit(config: dict[str, Any]) -> bool:
    return bool(config["sampling__p_uniform"] + config["sampling__p_sparse"] <= 1)


seeds = st.integers(0, 2**31)
configs: st.SearchStrategy[dict[str, Any]] = st.fixed_dictionaries(
    {
        "expansions": st.integers(1, 500),
        "batch__min": st.integers(1, 9),
        "batch__max": st.integers(9, 40),
        "batch__share": st.sampled_from([0.0, 1 / 32, 0.5]),
        "sampling__p_uniform": st.sampled_from([0.0, 0.2, 1.0]),
        "sampling__p_sparse": st.just(0.0) | st.floats(0, 0.8),
        "sampling__sparse_exponent": st.floats(0, 4),
        "sampling__crowding": st.sampled_from(["near", "reachable"]),
        "sampling__count_rejections": st.booleans(),
        "actions__edge": st.floats(0, 1),
        "actions__momentum": st.floats(0, 1),
        "actions__steer_goal": st.sampled_from([0.0, 0.3]),
        "actions__steer_sparse": st.sampled_from([0.0, 0.3]),
        "prune": st.booleans(),
        "rewire__enabled": st.booleans(),
        "rewire__candidates": st.integers(1, 5),
    }
).filter(_shares_fit)
worlds = st.builds(Box, stream=st.sampled_from([0.0, 0.05, 0.2]), wall=st.booleans())
radii = st.builds(
    replace,
    st.just(RADII),
    duplicate=st.sampled_from([0.0, 0.03]),
    crowding=st.floats(0.02, 0.2),
    longest=st.sampled_from([REACH, np.inf]),
)
law = settings(deadline=None, max_examples=25)


def grown(
    query: Query,
    world: Box | None = None,
    *,
    limits: Limits = LIMITS,
    radii: Radii = RADII,
    **config: Any,
) -> Search:
    """The search after its whole budget."""
    planner = ElastPlanner((world or Box()).at, tree_config(**config), limits, radii)
    search = Search(planner, query)
    search.run()
    return search


def edges(search: Search, b: int) -> tuple[Int64, Int64]:
    """Parents and children [E] of tree b's edges."""
    child = np.arange(1, search.forest.size[b])
    return search.forest.parent[b, child].astype(np.int64), child


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
        path = path_to(forest, b, i)
        assert path[0] == 0
        assert len(path) == depth[i] + 1
        listed, last, node = [], NONE, int(forest.child[b, i])
        while node != NONE:
            assert forest.before[b, node] == last
            listed.append(node)
            last, node = node, int(forest.after[b, node])
        assert sorted(listed) == np.flatnonzero(parent[:size] == i).tolist()
