"""Lazy search on maps: toy maps by hand, and the walled box whose ways are known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from elast_cli.planners.base import Limits, Plan, Query, Radii
from elast_cli.planners.graph.roadmap import Roadmap, roadmap
from elast_cli.planners.graph.search import PASSED, REJECTED, UNTESTED, GraphPlanner
from elast_cli.shapes import Float32, Int64
from tests.toys.box import REACH, Box, only, problems
from tests.toys.dynamics import array

RADII = Radii(neighbor=1.4 * REACH, goal=REACH, failure=0.5 * REACH)
LIMITS = Limits(min_log_density=-1.0, max_variance=0.1, max_round_trip=0.1 * REACH)
NO_CONTEXT = np.zeros((1, 0), np.float32)


@dataclass
class Picky(Box):
    """A box without walls and contexts in which ψ rejects steps into some places."""

    bad: tuple[tuple[float, float], ...] = ()

    def features(self, z: Float32, row: Int64) -> Float32:
        return z

    def log_density(self, features: Float32, source: Int64, target: Int64) -> Float32:
        out = np.zeros(len(target), np.float32)
        for place in self.bad:
            out[(features[target] == array(place)).all(1)] = -9
        return out

    def drift(self, context: Float32) -> Float32:
        return np.zeros((len(context), 2), np.float32)

    def at(self, context: Float32) -> Any:
        return replace(self, context=np.zeros((len(context), 1), np.float32))


def hand_map(radius: float = 0.13) -> Roadmap:
    """Two ways from (0, 0) to (0.4, 0): three nodes straight on, or four over the top."""
    places = [(0.1, 0), (0.2, 0), (0.3, 0), (0.08, 0.09), (0.16, 0.12), (0.24, 0.12), (0.32, 0.09)]
    return roadmap(array(places), np.arange(7) * 2, spacing=0.0, radius=radius)


def asked(start: Any = (0, 0), goal: Any = (0.4, 0), **more: Any) -> Query:
    at = [array([place]) for place in (start, goal)]
    return Query(at[0], at[1], NO_CONTEXT, np.array([0]), **more)


def by_hand(query: Query, bad: tuple[tuple[float, float], ...] = (), **changes: Any) -> Plan:
    settings = {"roadmap": hand_map(), "limits": LIMITS, "radii": RADII, "edge_tests": 1000}
    return GraphPlanner(world=Picky(bad=bad).at, **{**settings, **changes}).plan(query)


def heights(plan: Plan) -> list[float]:
    return [round(float(y), 2) for y in plan.states[0, : plan.length[0], 1]]


def test_the_shortest_path_is_taken_from_start_to_goal() -> None:
    plan = by_hand(asked())
    np.testing.assert_allclose(plan.states[0], np.linspace((0, 0), (0.4, 0), 5), atol=1e-6)
    assert plan.length.tolist() == [5]
    assert plan.reached.all()
    np.testing.assert_allclose(plan.actions[0], np.tile([0.1 / REACH, 0], (4, 1)), atol=1e-5)


def test_a_rejected_edge_leads_to_the_second_best_path() -> None:
    plan = by_hand(asked(), bad=((0.2, 0),))
    assert heights(plan) == [0, 0.09, 0.12, 0.12, 0.09, 0]
    assert plan.reached.all()
    verdicts: Any = plan.memory[0]
    assert (verdicts == REJECTED).any()


def test_where_no_way_is_left_the_path_ends_nearest_to_the_goal() -> None:
    plan = by_hand(asked(), bad=((0.2, 0), (0.24, 0.12)))
    assert not plan.reached.any()
    np.testing.assert_allclose(plan.states[0, plan.length[0] - 1], (0.16, 0.12), atol=1e-6)


def test_only_edges_about_the_path_are_tested() -> None:
    far = array([(-0.1 * i, -0.5) for i in range(9)])
    places = np.concatenate([hand_map().latents, far])
    wide = roadmap(places, np.arange(16) * 2, spacing=0.0, radius=0.13)
    verdicts: Any = by_hand(asked(), roadmap=wide).memory[0]
    away = wide.source >= 7
    assert away.any()
    assert (verdicts[away] == UNTESTED).all()
    assert (verdicts[~away] != UNTESTED).any()


def test_what_one_plan_tested_the_next_one_knows() -> None:
    first = by_hand(asked())
    again = by_hand(asked(memory=first.memory))
    np.testing.assert_array_equal(first.states, again.states)
    joins = again.cost.density_calls[0]
    assert joins < first.cost.density_calls[0]
    assert by_hand(asked(memory=[None])).cost.density_calls == first.cost.density_calls


def test_every_call_of_a_network_is_counted() -> None:
    plan = by_hand(asked(), roadmap=hand_map(0.101))
    tested = 1 + 6 + 1  # from the start, from the three nodes of the path, and to the goal
    assert plan.cost.density_calls[0] == tested
    assert plan.cost.policy_calls[0] == tested + 4  # the latter along the path
    assert plan.cost.transitions[0] == tested
    free = by_hand(asked(), roadmap=hand_map(0.101), limits=Limits())
    assert free.cost.density_calls[0] == 0


def test_a_place_that_execution_failed_to_reach_is_closed_and_a_blocked_row_is_named() -> None:
    failed = array([[(0.1, 0), (0.2, 0)]])
    plan = by_hand(asked(failed=[failed]), radii=replace(RADII, failure=0.05))
    assert heights(plan) == [0, 0.09, 0.12, 0.12, 0.09, 0]
    assert plan.blocked == []
    both = array([[(0.1, 0), (0.2, 0)], [(0.16, 0.12), (0.24, 0.12)]])
    assert by_hand(asked(failed=[both]), radii=replace(RADII, failure=0.05)).blocked == [0]


def test_a_goal_in_a_closed_place_is_not_walked_into_again() -> None:
    """Else a row would repeat its last step. A blocked row forgets its failures instead."""
    radii = replace(RADII, failure=0.05)
    for start in ((0.3, 0), (0.2, 0)):
        failed = array([[(0.3, 0), (0.4, 0)]])
        plan = by_hand(asked(start=start, failed=[failed]), radii=replace(radii, goal=0.05))
        assert not plan.reached.any()
        assert plan.blocked == [0]
        assert by_hand(asked(start=start), radii=radii).reached.all()


def test_a_start_whose_edges_all_fail_joins_the_nearest_open_node() -> None:
    failed = array([[(0.0, 0), (0.1, 0)]])
    near = by_hand(asked(start=(0.05, -0.3), failed=[failed]), radii=replace(RADII, failure=0.05))
    assert not np.isclose(near.states[0], (0.1, 0), atol=1e-6).all(1).any()


def test_a_spent_budget_leaves_only_edges_that_have_passed() -> None:
    plan = by_hand(asked(), bad=((0.2, 0),), edge_tests=1)
    known: Any = plan.memory[0]
    places = hand_map()
    nodes = [int(np.linalg.norm(places.latents - z, axis=1).argmin()) for z in plan.states[0, 1:]]
    for i, j in pairwise(nodes):
        if i != j:
            assert known[(places.source == i) & (places.target == j)].tolist() == [PASSED]


def test_a_start_off_the_map_goes_to_the_nearest_node_and_one_at_the_goal_goes_there() -> None:
    off = by_hand(asked(start=(0.1, -0.6)))
    assert heights(off)[1:] == [0, 0, 0, 0]
    at = by_hand(asked(start=(0.33, 0)))
    np.testing.assert_allclose(at.states[0], [(0.33, 0), (0.4, 0)], atol=1e-6)


def test_observed_transitions_need_no_test_unless_contexts_differ() -> None:
    seen = roadmap(
        hand_map().latents, np.array([0, 1, 2, 10, 20, 30, 40]), spacing=0.0, radius=0.13
    )
    assert heights(by_hand(asked(), bad=((0.2, 0),), roadmap=seen)) == [0, 0, 0, 0, 0]
    contexts = replace(asked(), context=np.zeros((1, 1), np.float32))
    tested = by_hand(contexts, bad=((0.2, 0),), roadmap=seen)
    assert heights(tested) == [0, 0.09, 0.12, 0.12, 0.09, 0]


# --- the walled box ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def box_map() -> Roadmap:
    places = np.random.default_rng(0).uniform(-1, 1, (1500, 2)).astype(np.float32)
    return roadmap(places, np.arange(1500) * 2, spacing=0.2 * REACH, radius=RADII.neighbor)


def through_the_door(query: Query, box_map: Roadmap) -> Plan:
    return GraphPlanner(Box().at, box_map, LIMITS, RADII, 200_000).plan(query)


def test_every_edge_of_a_path_is_possible_in_its_own_context(box_map: Roadmap) -> None:
    query, world = problems(6), Box()
    plan = through_the_door(query, box_map)
    assert plan.reached.all()
    for b in range(6):
        path = plan.states[b, : plan.length[b]]
        features = np.concatenate([path, np.tile(query.context[b], (len(path), 1))], axis=1)
        assert world.possible(path[:-1], features[1:]).all()
        assert plan.length[b] - 1 >= np.abs(query.goal[b] - query.start[b]).max() / REACH - 0.1
    assert (plan.cost.density_calls < len(box_map.source)).all()  # most edges are never tested


def test_a_row_of_a_batch_equals_its_solo_run(box_map: Roadmap) -> None:
    query = problems(4)
    together = through_the_door(query, box_map)
    for b in range(4):
        alone = through_the_door(only(query, b), box_map)
        length = alone.length[0]
        assert length == together.length[b]
        np.testing.assert_array_equal(together.states[b, :length], alone.states[0])
        np.testing.assert_array_equal(together.actions[b, : length - 1], alone.actions[0])
        for name, calls in vars(alone.cost).items():
            assert calls[0] == vars(together.cost)[name][b]
