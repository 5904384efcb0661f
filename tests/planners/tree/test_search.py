from __future__ import annotations

import itertools
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from elast_cli.planners.base import Radii
from elast_cli.planners.tree import expansion
from elast_cli.planners.tree.forest import path_to
from elast_cli.planners.tree.search import ElastPlanner, Search
from elast_cli.shapes import Float32, Int64
from tests.toys.box import REACH, Box, only, problems
from tests.toys.trees import (
    LIMITS,
    RADII,
    assert_sound,
    configs,
    edges,
    grown,
    law,
    radii,
    seeds,
    tree_config,
    worlds,
)

# ---- laws of the tree ---------------------------------------------------------------------------


@law
@given(seeds, configs, worlds, radii)
def test_trees_have_no_cycle_true_depths_and_true_child_lists(
    seed: int, config: dict[str, Any], world: Box, radii: Radii
) -> None:
    search = grown(problems(3, seed), world, radii=radii, **config)
    for b in range(3):
        assert_sound(search.forest, b)


@law
@given(seeds, configs, worlds)
def test_every_edge_passes_every_test(seed: int, config: dict[str, Any], world: Box) -> None:
    query = problems(2, seed)
    search = grown(query, world, **config)
    world = world.at(query.context)
    for b in range(2):
        source, target = edges(search, b)
        table = world.features(search.forest.latent[b], np.full(len(search.forest.latent[b]), b))
        assert (world.log_density(table, source, target) >= LIMITS.min_log_density).all()
        z, z_next = search.forest.latent[b, source], search.forest.latent[b, target]
        landed, variance = world.step(z, search.forest.action[b, target], np.full(len(source), b))
        assert (np.abs(landed - z_next) <= LIMITS.max_round_trip).all()
        assert (variance <= 2 * LIMITS.max_variance).all()  # the round trip moves it a little
        assert world.supported(z_next, LIMITS.max_support_distance).all()
        assert (np.abs(search.forest.action[b]) <= 1).all()


@pytest.mark.parametrize("off", ["min_log_density", "max_round_trip"])
@law
@given(seed=seeds, config=configs)
def test_no_edge_goes_against_a_one_way_stream(off: str, seed: int, config: dict[str, Any]) -> None:
    limits = replace(LIMITS, **{off: -np.inf if off == "min_log_density" else np.inf})
    search = grown(problems(2, seed), Box(stream=0.2), limits=limits, **config)
    for b in range(2):
        source, target = edges(search, b)
        x = search.forest.latent[b, :, 0]
        assert (x[target] - x[source] >= 0.2 - REACH - 1e-3).all()


@law
@given(seeds, configs, worlds, radii)
def test_a_row_of_a_batch_equals_its_solo_run(
    seed: int, config: dict[str, Any], world: Box, radii: Radii
) -> None:
    query = problems(3, seed)
    together = grown(query, world, radii=radii, **config)
    plans = together.best_plan()
    for b in range(3):
        alone = grown(only(query, b), world, radii=radii, **config)
        size = alone.forest.size[0]
        assert together.forest.size[b] == size
        for name in ("latent", "feature", "action", "parent", "depth", "crowding"):
            ours, theirs = getattr(together.forest, name), getattr(alone.forest, name)
            np.testing.assert_array_equal(ours[b, :size], theirs[0, :size], err_msg=name)
        plan, length = alone.best_plan(), plans.length[b]
        for name, calls in vars(plan.cost).items():
            assert getattr(plans.cost, name)[b] == calls[0]
        for name in ("length", "reached"):
            assert getattr(plans, name)[b] == getattr(plan, name)[0], name
        np.testing.assert_array_equal(plans.states[b, :length], plan.states[0])
        np.testing.assert_array_equal(plans.actions[b, : length - 1], plan.actions[0])


@law
@given(seeds, st.integers(1, 40), st.integers(1, 40), worlds)
def test_more_budget_never_deepens_a_node(seed: int, less: int, more: int, world: Box) -> None:
    query = problems(2, seed)
    batch: dict[str, Any] = {"batch__min": 12, "batch__max": 12, "rewire__candidates": 3}
    short = grown(query, world, **batch, expansions=12 * less)
    long = grown(query, world, **batch, expansions=12 * (less + more))
    for b in range(2):
        size = short.forest.size[b]
        np.testing.assert_array_equal(short.forest.latent[b, :size], long.forest.latent[b, :size])
        assert (long.forest.depth[b, :size] <= short.forest.depth[b, :size]).all()


@law
@given(seeds, worlds, st.sampled_from(["near", "reachable"]))
def test_rewiring_never_deepens_a_node(seed: int, world: Box, crowding: str) -> None:
    query = problems(2, seed)
    # momentum and pruning would follow the tree
    same: dict[str, Any] = {"expansions": 500, "actions__momentum": 0.0, "prune": False}
    same["sampling__crowding"] = crowding
    plain = grown(query, world, rewire__enabled=False, **same)
    rewired = grown(query, world, **same)
    np.testing.assert_array_equal(plain.forest.size, rewired.forest.size)
    for b in range(2):
        size = plain.forest.size[b]
        np.testing.assert_array_equal(
            plain.forest.latent[b, :size], rewired.forest.latent[b, :size]
        )
        assert (rewired.forest.depth[b, :size] <= plain.forest.depth[b, :size]).all()


def test_rewiring_shortens_paths() -> None:
    query = problems(4)
    same: dict[str, Any] = {"expansions": 1500, "actions__momentum": 0.0}
    plain, rewired = grown(query, rewire__enabled=False, **same), grown(query, **same)
    mean = [
        np.mean([s.forest.depth[b, : s.forest.size[b]].mean() for b in range(4)])
        for s in (rewired, plain)
    ]
    assert mean[0] < 0.8 * mean[1]


# ---- budgets and counts -------------------------------------------------------------------------


@law
@given(seeds, configs)
def test_the_budget_bounds_the_tree_and_the_calls(seed: int, config: dict[str, Any]) -> None:
    unsteered: dict[str, Any] = {
        "actions__steer_goal": 0.0,
        "actions__steer_sparse": 0.0,
        "prune": False,
    }
    search = grown(problems(2, seed), **config | unsteered)
    plan, budget = search.best_plan(), config["expansions"]
    assert search.done == budget
    assert (search.forest.size <= budget + 1).all()
    np.testing.assert_array_equal(plan.cost.transitions, budget + plan.cost.policy_calls)
    assert config["rewire__enabled"] or not plan.cost.policy_calls.any()


def test_the_calls_of_an_ensemble_count_for_each_member() -> None:
    world = Box(members=5)
    plan = grown(problems(2), world, expansions=100, rewire__enabled=False).best_plan()
    assert plan.cost.transitions.tolist() == [500, 500]


def test_batches_grow_with_the_tree_between_their_bounds() -> None:
    planner = ElastPlanner(
        Box().at,
        tree_config(expansions=400, batch__min=4, batch__max=20, batch__share=0.1),
        LIMITS,
        RADII,
    )
    search, sizes = Search(planner, problems(1)), []
    while search.done < 400:
        before = search.done
        search.expand(np.arange(1))
        sizes.append(search.done - before)
    assert sizes[0] == 4
    assert max(sizes) == 20
    assert sizes[:-1] == sorted(sizes[:-1])
    assert sum(sizes) == 400


@law
@given(seeds, st.integers(1, 60), worlds)
def test_a_full_tree_stops_and_is_that_of_a_solo_run(seed: int, nodes: int, world: Box) -> None:
    query = problems(3, seed)
    together = grown(query, world, expansions=300, max_nodes=nodes)
    assert together.forest.capacity == nodes
    for b in range(3):
        alone = grown(only(query, b), world, expansions=300, max_nodes=nodes)
        size = alone.forest.size[0]
        assert together.forest.size[b] == size <= nodes
        assert_sound(together.forest, b)
        for name in ("latent", "parent", "crowding"):
            ours, theirs = getattr(together.forest, name), getattr(alone.forest, name)
            np.testing.assert_array_equal(ours[b, :size], theirs[0, :size], err_msg=name)
        assert together.cost.transitions[b] == alone.cost.transitions[0]


def test_a_time_budget_bounds_a_plan_whatever_its_expansions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ticks = itertools.count(step=0.01)  # each look at the clock takes a hundredth of a second
    monkeypatch.setattr(time, "monotonic", lambda: next(ticks))
    few, more = (grown(problems(2), expansions=10**6, time_budget=s) for s in (0.05, 0.5))
    assert 0 < few.done < more.done < 10**6


def test_a_rejected_expansion_crowds_its_node() -> None:
    walled = replace(LIMITS, max_variance=-1.0)  # nothing passes
    counted = grown(problems(2), limits=walled, expansions=50)
    assert counted.forest.crowding[:, 0].tolist() == [50, 50]
    plain = grown(problems(2), limits=walled, expansions=50, sampling__count_rejections=False)
    assert plain.forest.crowding[:, 0].tolist() == [0, 0]


@pytest.mark.parametrize("batch", [1, 64])
def test_crowding_counts_the_nodes_within_its_radius(batch: int) -> None:
    sizes: dict[str, Any] = {"batch__min": batch, "batch__max": batch}
    search = grown(problems(2), expansions=320, **sizes, sampling__count_rejections=False)
    for b in range(2):
        latent = search.forest.latent[b, : search.forest.size[b]].astype(np.float64)
        gap = np.linalg.norm(latent[:, None] - latent, axis=2)
        within = (gap <= RADII.crowding).sum(1) - 1  # not itself
        np.testing.assert_array_equal(search.forest.crowding[b, : len(latent)], within)


@pytest.mark.parametrize("batch", [1, 128])
def test_no_node_is_a_copy_of_one_that_is_no_costlier(batch: int) -> None:
    radii = replace(RADII, duplicate=0.05)
    sizes: dict[str, Any] = {"batch__min": batch, "batch__max": batch}
    search = grown(problems(2), expansions=1024, **sizes, rewire__enabled=False, radii=radii)
    for b in range(2):
        size = search.forest.size[b]
        latent, depth = search.forest.latent[b, :size], search.forest.depth[b, :size]
        near = np.linalg.norm(latent[:, None] - latent, axis=2) < radii.duplicate * (1 - 1e-4)
        later, earlier = np.nonzero(np.tril(near, -1))
        assert (depth[earlier] > depth[later]).all()


def test_reachable_crowding_counts_who_can_come_in() -> None:
    world, query = Box(stream=0.2, wall=False), problems(1)
    search = grown(
        query,
        world,
        expansions=200,
        batch__min=1,
        batch__max=1,
        sampling__count_rejections=False,
        sampling__crowding="reachable",
        radii=replace(RADII, crowding=np.inf, neighbor=0.3),
    )
    size = search.forest.size[0]
    table = world.at(query.context).features(search.forest.latent[0, :size], np.zeros(size, int))
    i, j = np.nonzero(~np.eye(size, dtype=bool))
    near = np.linalg.norm(table[i, :2] - table[j, :2], axis=1) <= 0.3
    likely = world.log_density(table, i, j) >= LIMITS.min_log_density
    leaving = np.bincount(i[near & likely], minlength=size)
    np.testing.assert_array_equal(search.forest.crowding[0, :size], leaving)


# ---- plans --------------------------------------------------------------------------------------


def test_a_plan_is_a_path_of_the_tree_from_start_to_goal() -> None:
    query = problems(6)
    world, plan = Box().at(query.context), grown(query, expansions=4000).best_plan()
    assert plan.reached.all()
    for b in range(6):
        path = plan.states[b, : plan.length[b]]
        np.testing.assert_array_equal(path[0], query.start[b])
        assert np.linalg.norm(path[-1] - query.goal[b]) <= RADII.goal
        z = path[0]
        for action, waypoint in zip(plan.actions[b], path[1:], strict=False):
            z = world.step(z[None], action[None], np.full(1, b))[0][0]
            np.testing.assert_allclose(z, waypoint, atol=plan.length[b] * LIMITS.max_round_trip)
        np.testing.assert_array_equal(
            plan.states[b, plan.length[b] - 1 :],
            path[-1:].repeat(plan.states.shape[1] - plan.length[b] + 1, axis=0),
        )


def test_a_plan_is_nearly_the_shortest_where_the_way_is_free() -> None:
    query = replace(problems(6), context=np.zeros((6, 1), np.float32))
    plan = grown(query, Box(wall=False), expansions=4000).best_plan()
    straight = np.ceil((np.abs(query.goal - query.start).max(1) - RADII.goal) / REACH)
    assert plan.reached.all()
    assert (plan.length - 1 <= straight + 2).all()


def test_no_way_is_no_plan_but_a_value() -> None:
    query = replace(problems(2), context=np.full((2, 1), 9, np.float32))  # no door
    plan = grown(query, expansions=1500).best_plan()
    assert not plan.reached.any()
    assert (plan.states[..., 0] < 0).all()


def test_the_end_of_a_plan_is_the_cheapest_node_in_the_goal_then_the_nearest() -> None:
    search = grown(problems(4), expansions=3000)
    nodes, reached = search.best_nodes()
    forest = search.forest
    for b in np.flatnonzero(reached):
        gap = np.linalg.norm(forest.latent[b, : forest.size[b]] - search.query.goal[b], axis=1)
        inside = np.flatnonzero(gap <= RADII.goal)
        cheapest = forest.depth[b, inside].min()
        assert forest.depth[b, nodes[b]] == cheapest
        assert gap[nodes[b]] == gap[inside[forest.depth[b, inside] == cheapest]].min()


class Broken(Box):
    """Predicts nonsense."""

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        z_next, variance = super().step(z, action, row)
        return z_next * np.float32(np.nan), variance


def test_predictions_that_are_no_numbers_are_rejected() -> None:
    search = grown(problems(2), Broken(), expansions=50)
    assert search.forest.size.tolist() == [1, 1]
    plan = search.best_plan()
    assert plan.length.tolist() == [1, 1]
    assert plan.actions.shape == (2, 0, 2)
    assert not plan.reached.any()


def test_the_same_seed_gives_the_same_plan_and_another_seed_another() -> None:
    query = problems(1)
    one, again = (grown(query, expansions=300).forest.latent for _ in range(2))
    np.testing.assert_array_equal(one, again)
    other = grown(replace(query, seed=query.seed + 1), expansions=300).forest.latent
    assert not np.array_equal(one, other)


def test_edge_actions_lie_on_the_edge_of_the_box() -> None:
    search = grown(
        problems(1),
        Box(wall=False),
        expansions=300,
        actions__edge=1.0,
        actions__momentum=0.0,
        rewire__enabled=False,
    )
    action = search.forest.action[0, 1 : search.forest.size[0]]
    np.testing.assert_allclose(np.abs(action).max(1), 1, atol=1e-6)


def test_momentum_keeps_the_direction_of_the_edge_before() -> None:
    def turn(momentum: float) -> float:
        search = grown(
            problems(1),
            Box(wall=False),
            expansions=800,
            actions__momentum=momentum,
            rewire__enabled=False,
        )
        forest = search.forest
        child = np.arange(1, forest.size[0])
        child = child[forest.parent[0, child] > 0]
        here, before = forest.action[0, child], forest.action[0, forest.parent[0, child]]
        return float((here * before).sum(1).mean())

    assert turn(1.0) > turn(0.0) + 0.3


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        ({"sampling__p_uniform": 0.5, "sampling__p_sparse": 0.6}, "p_goal"),
        ({"batch__min": 9, "batch__max": 8}, "min must not exceed max"),
        ({"expansions": 0}, "greater than or equal to 1"),
    ],
)
def test_a_config_that_makes_no_sense_is_refused(bad: dict[str, Any], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        tree_config(**bad)


def test_paths_end_where_they_should() -> None:
    search = grown(problems(1), expansions=200)
    deepest = int(search.forest.depth[0].argmax())
    path = path_to(search.forest, 0, deepest)
    assert (path[0], path[-1]) == (0, deepest)
    assert search.forest.parent[0, path[1:]].tolist() == path[:-1]


# ---- what need not be searched ------------------------------------------------------------------


@law
@given(seeds, configs, worlds, radii)
def test_only_what_cannot_shorten_the_path_is_pruned(
    seed: int, config: dict[str, Any], world: Box, radii: Radii
) -> None:
    search = grown(problems(2, seed), world, radii=radii, **config | {"prune": True})
    forest, leaves = search.forest, search.growth.sparsity.sums.shape[1] // 2
    for b in range(2):
        size = forest.size[b]
        far = np.linalg.norm(forest.latent[b, :size] - forest.goal[b], axis=1)
        np.testing.assert_allclose(forest.to_goal[b, :size], far, rtol=1e-5)
        weighted = search.growth.sparsity.sums[b, leaves : leaves + size] > 0
        inside = forest.to_goal[b, :size] <= radii.goal
        if not inside.any():
            assert weighted.all()
            continue
        cost = forest.depth[b, :size][inside].min()
        ahead = np.maximum(1, np.ceil((forest.to_goal[b, :size] - radii.goal) / radii.longest))
        np.testing.assert_array_equal(weighted, forest.depth[b, :size] + ahead < cost)


def steps_to(goal: Float32, z: Float32, radius: float) -> int:
    """The least number of steps from z [2] to within `radius` of `goal` [2], without walls."""
    beyond = np.abs(goal.astype(np.float64) - z)
    return next(n for n in range(99) if np.linalg.norm((beyond - n * REACH).clip(0)) <= radius)


@law
@given(seeds, configs, st.floats(0.02, 0.2))
def test_no_pruned_node_could_have_shortened_the_path(
    seed: int, config: dict[str, Any], goal: float
) -> None:
    query = problems(2, seed)
    query = replace(query, context=np.zeros_like(query.context))  # no wind
    radii = replace(RADII, goal=goal, longest=np.sqrt(2) * REACH)
    search = grown(query, Box(wall=False), radii=radii, **config | {"prune": True})
    forest, leaves = search.forest, search.growth.sparsity.sums.shape[1] // 2
    for b in range(2):
        latent, depth = (x[b, : forest.size[b]] for x in (forest.latent, forest.depth))
        cost = depth[np.linalg.norm(latent - query.goal[b], axis=1) <= goal].min(initial=999)
        for i in np.flatnonzero(search.growth.sparsity.sums[b, leaves : leaves + len(depth)] == 0):
            expanded = max(1, steps_to(query.goal[b], latent[i], goal - 1e-4))
            assert depth[i] + expanded >= cost


def test_crowded_nodes_are_not_taken_for_pruned_ones() -> None:
    search = grown(problems(2), expansions=400, sampling__sparse_exponent=400.0, prune=False)
    leaves = search.growth.sparsity.sums.shape[1] // 2
    for b in range(2):
        assert (search.growth.sparsity.sums[b, leaves : leaves + search.forest.size[b]] > 0).all()


def test_a_tree_that_cannot_do_better_stops() -> None:
    query = problems(2)
    start = query.goal + np.float32(0.5 * RADII.goal)
    search = grown(replace(query, start=start), expansions=500)
    assert search.forest.size.max() < 500
    assert search.done < 500
    assert search.best_plan().length.tolist() == [1, 1]


def test_the_policy_steers_towards_the_goal() -> None:
    query = problems(3, seed=4)
    search = grown(query, expansions=1, batch__min=1, actions__steer_goal=1.0)
    assert (search.cost.policy_calls >= 1).all()
    action = np.zeros((3, 2), np.float32)
    expansion._steer(search.growth, query.start, action, np.arange(3), np.zeros((3, 8)))
    step = query.goal - query.start
    step *= RADII.neighbor / np.linalg.norm(step, axis=1, keepdims=True)
    expected = Box().at(query.context).act(query.start, query.start + step, np.arange(3))
    np.testing.assert_allclose(action, expected, atol=1e-5)


def test_the_policy_steers_towards_sparse_nodes() -> None:
    query = problems(1, seed=4)
    search = grown(query, expansions=200, batch__min=8, batch__max=8, actions__steer_sparse=0.9)
    root = np.repeat(query.start, 50, 0)
    action, draws = np.zeros((50, 2), np.float32), np.random.default_rng(0).random((50, 8))
    expansion._steer(search.growth, root, action, np.zeros(50, int), draws)
    assert len(np.unique(action, axis=0)) > 10  # to many nodes, each within one step's reach
    assert (np.abs(action) <= 1).all()


def test_a_later_plan_stops_soon_after_it_has_reached_the_goal_and_a_first_one_does_not() -> None:
    query = problems(1, seed=3)
    config: dict[str, Any] = {
        "reuse__expansions": 50,
        "batch__min": 8,
        "batch__max": 8,
        "prune": False,
    }
    stunted = grown(query, expansions=8, **config).best_plan()
    assert not stunted.reached.any()
    later = grown(replace(query, memory=stunted.memory), expansions=5000, **config)
    first = grown(query, expansions=5000, **config)
    assert first.done == 5000
    assert later.best_plan().reached.all()
    assert later.done < 5000
    early = grown(replace(query, memory=stunted.memory), expansions=later.done - 70, **config)
    assert not early.best_plan().reached.any()


# ---- the frontier -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_a_search_that_finds_nothing_new_is_exhausted_and_a_young_one_is_not(seed: int) -> None:
    query = replace(problems(1, seed), goal=np.full((1, 2), 5, np.float32))
    assert not grown(query, expansions=200).exhausted()[0]
    search = grown(query, expansions=6000)
    assert search.exhausted()[0]
    plan = search.best_plan()
    assert plan.exhausted() == [True]
    assert plan.nodes == search.forest.size.tolist()


def test_a_search_that_cannot_leave_its_root_is_exhausted() -> None:
    query = problems(1)
    shut = replace(LIMITS, min_log_density=1e9)
    assert grown(query, limits=shut, expansions=6000).exhausted()[0]
    assert not grown(query, limits=shut, expansions=200).exhausted()[0]


def test_a_search_that_arrives_is_not_exhausted() -> None:
    search = grown(problems(1), expansions=3000)
    assert search.best_nodes()[1][0]
    assert not search.exhausted()[0]
