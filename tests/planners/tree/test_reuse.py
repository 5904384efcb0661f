from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners.base import Plan, Query
from elast_cli.planners.grid import NONE
from elast_cli.planners.tree import reuse
from elast_cli.planners.tree.forest import plant
from elast_cli.planners.tree.reuse import Memory
from elast_cli.planners.tree.search import ROOT_EXPANSIONS, ElastPlanner, Search
from elast_cli.shapes import Bool, Float32, Int64
from tests.toys.box import Box, only, problems
from tests.toys.trees import LIMITS, RADII, assert_sound, grown, tree_config, worlds

BUDGET: dict[str, Any] = {"expansions": 400, "reuse__expansions": 100}
FAILING = replace(RADII, failure=0.1)
NO_FAILURE = np.zeros((0, 2, 2), np.float32)

seeds = st.integers(0, 2**31)
law = settings(deadline=None, max_examples=25)


def tree_of(parent: list[int]) -> Memory:
    """A tree whose node i lies at (i, 0) and was reached by action i; parents come first."""
    count = len(parent)
    number = np.arange(count, dtype=np.float32)[:, None]
    depth = np.zeros(count, np.int32)
    for i, above in enumerate(parent):
        depth[i] = 0 if above == NONE else depth[above] + 1
    latent = np.concatenate([number, np.zeros_like(number)], axis=1)
    crowding = np.arange(count, dtype=np.int32)
    return Memory(latent, number, number, np.array(parent, np.int32), depth, crowding)


@st.composite
def plantings(draw: st.DrawFn) -> tuple[Memory, Int64]:
    """A shuffled tree, and nodes to adopt, in rising order."""
    count = draw(st.integers(1, 30))
    memory = tree_of([NONE] + [draw(st.integers(0, i - 1)) for i in range(1, count)])
    order = np.array(draw(st.permutations(range(count))))  # node order[i] comes to place i
    place = np.argsort(order)
    parent = memory.parent[order]
    parent = np.where(parent == NONE, NONE, place[parent]).astype(np.int32)
    shuffled = replace(
        memory,
        latent=memory.latent[order],
        feature=memory.feature[order],
        action=memory.action[order],
        parent=parent,
        depth=memory.depth[order],
        crowding=memory.crowding[order],
    )
    adopted = draw(st.sets(st.integers(0, count - 1)))
    return shuffled, np.array(sorted(adopted), np.int64)


def hung(memory: Memory, adopted: Int64) -> Memory:
    """The tree hung from (-1, 0), with actions of -1 to what it adopts."""
    root = np.array([-1, 0], np.float32)
    actions = np.full((len(adopted), 1), -1, np.float32)
    return reuse.transplant(memory, root, root[:1], adopted, actions)


def numbers(memory: Memory) -> list[int]:
    """The names of the nodes of `tree_of`: where they lie."""
    return [int(x) for x in memory.latent[:, 0]]


# ---- hanging a tree from a new root -------------------------------------------------------------


@law
@given(plantings())
def test_transplanted_depths_are_exact_and_parents_come_first(given: tuple[Memory, Int64]) -> None:
    new = hung(*given)
    assert new.parent[0] == NONE
    assert new.depth[0] == 0
    parent = new.parent[1:]
    assert ((parent >= 0) & (parent < np.arange(1, len(new.parent)))).all()
    np.testing.assert_array_equal(new.depth[1:], new.depth[parent] + 1)
    assert (np.diff(new.depth) >= 0).all()


@law
@given(plantings())
def test_every_edge_was_in_the_old_tree_or_is_an_adopted_one(given: tuple[Memory, Int64]) -> None:
    old, adopted = given
    new, name = hung(old, adopted), numbers(old)
    above = {n: None if p == NONE else name[p] for n, p in zip(name, old.parent, strict=True)}
    children, names = {name[i] for i in adopted}, numbers(new)
    for i in range(1, len(names)):
        parent, action = names[new.parent[i]], float(new.action[i, 0])
        if names[i] in children:
            assert (parent, action) == (-1, -1.0)
        else:
            assert (parent, action) == (above[names[i]], float(names[i]))


@law
@given(plantings())
def test_what_descends_from_the_adopted_is_kept_and_nothing_else(
    given: tuple[Memory, Int64],
) -> None:
    old, adopted = given
    kept = []
    for i in range(len(old.parent)):
        up = i
        while up not in adopted and up != NONE:
            up = int(old.parent[up])
        kept += [i] if up != NONE else []
    new = hung(old, adopted)
    assert sorted(numbers(new)[1:]) == sorted(numbers(old)[i] for i in kept)
    np.testing.assert_array_equal(new.feature[1:, 0], new.latent[1:, 0])
    np.testing.assert_array_equal(new.crowding[1:], numbers(new)[1:])


def test_nodes_that_hang_from_nowhere_are_dropped() -> None:
    memory = tree_of([NONE, 0, 1, 2, 0, 4])
    assert numbers(hung(memory, np.array([2]))) == [-1, 2, 3]
    assert numbers(hung(memory, np.array([], np.int64))) == [-1]


def test_a_node_that_is_adopted_may_rise_with_all_that_hangs_from_it() -> None:
    new = hung(tree_of([NONE, 0, 1, 2, 3]), np.array([0, 3]))
    assert dict(zip(numbers(new), new.depth.tolist(), strict=True)) == {
        -1: 0, 0: 1, 3: 1, 1: 2, 4: 2, 2: 3,
    }  # fmt: skip


def test_candidates_lie_within_the_radius_of_the_new_root() -> None:
    memory, root = tree_of([NONE, 0, 1, 2, 3]), np.array([2, 0], np.float32)
    assert reuse.candidates(memory, root, 1.0).tolist() == [1, 2, 3]
    assert reuse.candidates(memory, root + 9, 1.0).tolist() == []


def test_a_restored_tree_is_the_remembered_one_as_far_as_there_is_room() -> None:
    memory = hung(tree_of([NONE, 0, 1, 1, 3]), np.array([0]))
    for nodes in (9, 6, 3):
        goal = np.array([[9, 0]], np.float32)
        forest = plant(memory.latent[:1], memory.feature[:1], goal, nodes=nodes, extra=1, actions=1)
        reuse.restore(forest, 0, memory)
        size = min(nodes, 6)
        assert_sound(forest, 0)
        again = reuse.remember(forest, 0)
        for name in ("latent", "feature", "action", "parent", "depth", "crowding"):
            np.testing.assert_array_equal(getattr(again, name), getattr(memory, name)[:size])
        gap = np.linalg.norm(memory.latent[:size] - goal, axis=1)
        assert forest.nearest.tolist() == [gap.argmin()]


def test_a_tree_is_kept_as_far_as_it_is_worth_growing() -> None:
    memory = hung(tree_of([NONE, 0, 1, 2, 3, 4]), np.array([0]))  # nodes at -1, 0, 1, ..., 5
    near, far = np.array([1.2, 0], np.float32), np.array([5, 0], np.float32)

    def kept(goal: Float32, room: int) -> int:
        return len(reuse.fitted(memory, goal, 0.5, room).depth)

    assert kept(near, 4) == 4  # cut to its cheapest nodes
    assert kept(near, 2) == 1  # these do not reach the goal
    assert kept(far, 7) == 7
    assert kept(far, 6) == 1
    assert kept(np.array([9, 0], np.float32), 13) == 1
    assert kept(np.array([9, 0], np.float32), 14) == 7


# ---- failed transitions -------------------------------------------------------------------------


def test_what_lies_about_a_failed_way_is_closed_from_one_radius_on() -> None:
    failed = np.array([[[0, 0], [1, 0]]], np.float32)
    places = [[0.5, 0], [1, 0.19], [1.19, 0], [0.2, 0.19], [0.05, 0]]
    others = [[0, 0], [-0.1, 0], [1, 0.3], [1.3, 0], [0, 0.15], [0.1, 0.19]]
    assert reuse.closed(np.array(places, np.float32), failed, 0.2).all()
    assert not reuse.closed(np.array(others, np.float32), failed, 0.2).any()
    assert not reuse.closed(np.array(places, np.float32), NO_FAILURE, 0.2).any()


def test_a_short_attempt_closes_what_lies_one_radius_ahead() -> None:
    failed = np.array([[[5, 5], [5, 5.01]], [[0, 0], [0, 0]]], np.float32)
    z = np.array([[5, 5.2], [5, 5.39], [5, 4.99], [0, 0]], np.float32)
    assert reuse.closed(z, failed, 0.2).tolist() == [True, True, False, False]


def test_a_cut_edge_leaves_what_it_held_to_whoever_adopts_it() -> None:
    failed = np.array([[[1, 0], [2, 0]]], np.float32)
    memory = reuse.without(tree_of([NONE, 0, 1, 2]), failed, 0.1)
    assert memory.parent.tolist() == [NONE, 0, NONE, 2]
    assert numbers(hung(memory, np.array([0]))) == [-1, 0, 1]
    assert sorted(numbers(hung(memory, np.array([0, 2])))) == [-1, 0, 1, 2, 3]


# ---- replanning ---------------------------------------------------------------------------------


def later(query: Query, plan: Plan, steps: int = 2) -> Query:
    """The query once each row has come a few steps along its plan, a little off the way."""
    at = np.minimum(plan.length - 1, steps)
    z = plan.states[np.arange(len(at)), at]
    off = np.random.default_rng(0).uniform(-0.02, 0.02, z.shape).astype(np.float32)
    return replace(query, start=z + off, seed=query.seed + 1, memory=plan.memory)


def failures(query: Query, plan: Plan) -> list[Float32]:
    """For each row the first two steps of its plan, and one from its new start."""
    out = []
    for b, states in enumerate(plan.states):
        pairs = [states[i : i + 2] for i in range(min(2, plan.length[b] - 1))]
        ahead = query.start[b] + np.array([0.1, 0], np.float32)
        out.append(np.stack([*pairs, np.stack([query.start[b], ahead])]))
    return out


def ends(search: Search, b: int) -> tuple[Float32, Float32]:
    """Where the edges of tree b begin and end [E,Z]."""
    child = np.arange(1, search.forest.size[b])
    return search.forest.latent[b, search.forest.parent[b, child]], search.forest.latent[b, child]


def admissible(world: Box, search: Search, b: int) -> Bool:
    """Whether each edge of tree b passes every test [E], in the world of this row alone."""
    z, z_next = ends(search, b)
    row = np.zeros(len(z), np.int64)
    table = world.features(np.concatenate([z, z_next]), np.repeat(row, 2))
    source = np.arange(len(z))
    landed, variance = world.step(z, search.forest.action[b, 1 : len(z) + 1], row)
    passed: Bool = world.log_density(table, source, source + len(z)) >= LIMITS.min_log_density
    passed &= (np.abs(landed - z_next) <= LIMITS.max_round_trip).all(1)
    passed &= variance <= 2 * LIMITS.max_variance  # the round trip moves it a little
    return passed & world.supported(z_next, LIMITS.max_support_distance)


@law
@given(seeds, worlds, st.booleans())
def test_the_laws_of_the_tree_hold_after_reuse(seed: int, world: Box, failing: bool) -> None:
    query = problems(2, seed)
    for _ in range(3):
        search = grown(query, world, radii=FAILING, **BUDGET)
        for b in range(2):
            assert_sound(search.forest, b)
            np.testing.assert_array_equal(search.forest.latent[b, 0], query.start[b])
            assert admissible(world.at(query.context[b : b + 1]), search, b).all()
        plan = search.best_plan()
        query = later(query, plan)
        if failing:
            query = replace(query, failed=failures(query, plan))


@law
@given(seeds, worlds)
def test_no_edge_leads_into_a_closed_place(seed: int, world: Box) -> None:
    query = problems(3, seed)
    plan = grown(query, world, **BUDGET).best_plan()
    query = later(query, plan, steps=0)
    query = replace(query, failed=failures(query, plan))
    for again in (query, replace(query, memory=())):
        search = grown(again, world, radii=FAILING, **BUDGET)
        for b in range(3):
            _, into = ends(search, b)
            assert not reuse.closed(into, query.failed[b], FAILING.failure).any()


def test_other_failures_than_those_of_the_tree_change_nothing_but_what_they_forbid() -> None:
    query = problems(2)
    far = np.full((1, 2, 2), 9, np.float32)
    told = grown(replace(query, failed=[far, far]), radii=FAILING, **BUDGET)
    plain = grown(query, radii=FAILING, **BUDGET)
    np.testing.assert_array_equal(told.forest.latent, plain.forest.latent)


@law
@given(seeds, worlds, st.sampled_from([None, 150, 300]))
def test_a_row_of_a_replanned_batch_equals_its_solo_run(
    seed: int, world: Box, max_nodes: int | None
) -> None:
    first = problems(4, seed)
    plan = grown(first, world, **BUDGET).best_plan()
    query = later(first, plan)
    failed = failures(query, plan)
    query = replace(
        query,
        memory=[None, plan.memory[1], plan.memory[2], None],
        failed=[NO_FAILURE, NO_FAILURE, failed[2], failed[3]],
    )
    config = {**BUDGET, "max_nodes": max_nodes}
    together = grown(query, world, radii=FAILING, **config)
    plans = together.best_plan()
    for b in range(4):
        alone = grown(only(query, b), world, radii=FAILING, **config)
        ours, theirs = reuse.remember(together.forest, b), reuse.remember(alone.forest, 0)
        for name in ("latent", "feature", "action", "parent", "depth", "crowding"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
        plan, length = alone.best_plan(), plans.length[b]
        for name, calls in vars(plan.cost).items():
            assert getattr(plans.cost, name)[b] == calls[0], name
        for name in ("length", "reached"):
            assert getattr(plans, name)[b] == getattr(plan, name)[0], name
        np.testing.assert_array_equal(plans.states[b, :length], plan.states[0])
        np.testing.assert_array_equal(plans.actions[b, : length - 1], plan.actions[0])


def spent(search: Search) -> Int64:
    """Expansions of each row [B]: every other prediction comes with a call of π."""
    return search.cost.transitions - search.cost.policy_calls


def test_a_replanned_search_spends_little_where_the_old_tree_reaches_the_goal() -> None:
    query = problems(4)
    plan = grown(query, expansions=3000).best_plan()
    assert plan.reached.all()
    budget: dict[str, Any] = {"expansions": 1500, "reuse__expansions": 130}
    query = replace(later(query, plan), memory=[plan.memory[0], None, *plan.memory[2:]])
    away = replace(query, goal=query.goal.copy())
    away.goal[2] = 9  # nowhere near any node
    away.start[3] += 5  # nor is this start
    search = grown(away, **budget)
    *others, lost = spent(search).tolist()
    assert others == [130, 1500, 1500]
    assert ROOT_EXPANSIONS <= lost < 1500  # a tree that cannot leave its root stops
    assert search.best_plan().reached[0]
    assert search.forest.size[2] > len(plan.memory[2].depth) / 2  # type: ignore[attr-defined]


@pytest.mark.parametrize("replan", [50, 200])
def test_replanning_never_spends_more_than_planning(replan: int) -> None:
    query = problems(2)
    plan = grown(query, expansions=3000).best_plan()
    search = grown(later(query, plan), expansions=100, reuse__expansions=replan, max_nodes=5000)
    assert spent(search).tolist() == [min(100, replan)] * 2


def test_crowded_nodes_of_the_old_tree_are_seldom_drawn() -> None:
    query = problems(2)
    query = later(query, grown(query, **BUDGET).best_plan())
    config = tree_config(**BUDGET, sampling__sparse_exponent=2.0)
    search = Search(ElastPlanner(Box().at, config, LIMITS, RADII), query)
    for b in range(2):
        crowding = search.forest.crowding[b, : search.forest.size[b]]
        assert crowding.max() > 5
        sums = search.growth.sparsity.sums[b]
        leaves = sums[len(sums) // 2 :][: len(crowding)]
        np.testing.assert_allclose(leaves, (1.0 + crowding) ** -2)


def test_without_reuse_memory_is_neither_kept_nor_used() -> None:
    query = problems(2)
    plan = grown(query, **BUDGET).best_plan()
    told, plain = later(query, plan), replace(later(query, plan), memory=())
    ours, theirs = (grown(q, reuse__enabled=False, **BUDGET) for q in (told, plain))
    np.testing.assert_array_equal(ours.forest.latent, theirs.forest.latent)
    assert ours.best_plan().memory == ()


def test_a_full_tree_that_does_not_reach_the_goal_gives_way_to_a_new_one() -> None:
    query = problems(2)
    config = {**BUDGET, "max_nodes": 60}
    plan = grown(query, **config).best_plan()
    assert not plan.reached.any()
    again = replace(query, memory=plan.memory, seed=query.seed + 1)
    search = grown(again, **config)
    assert (spent(search) > 0).all()


def test_a_nearly_full_tree_that_does_not_reach_the_goal_gives_way_as_the_start_moves() -> None:
    query = replace(problems(3), context=np.full((3, 1), 9, np.float32))  # no door
    config: dict[str, Any] = {"expansions": 4000, "max_nodes": 300}
    plan = grown(query, **config).best_plan()
    for step in range(1, 5):
        query = later(query, plan, steps=0)
        search = grown(query, **config)
        assert (spent(search) >= 150).all(), step
        plan = search.best_plan()
        assert not plan.reached.any()


def test_an_episodes_memory_is_bounded() -> None:
    query = problems(2)
    config: dict[str, Any] = {"expansions": 1500, "reuse__expansions": 600, "prune": False}
    plan = grown(query, **config).best_plan()
    sizes = []
    for _ in range(8):
        assert plan.reached.all()
        query = later(query, plan, steps=0)
        search = grown(query, **config)
        sizes.append(search.forest.size.max())
        plan = search.best_plan()
    assert max(sizes) > 3000  # it was cut
    assert max(sizes) <= 3000 + 600
