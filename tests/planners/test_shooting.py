from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.planners import shooting
from elast_cli.planners.base import Plan, Query
from elast_cli.planners.refined_tree import BAND, ShootingPlanner, endings
from elast_cli.planners.shooting import Shot, end_slope, shots
from elast_cli.planners.tree.search import ElastPlanner
from elast_cli.shapes import Float32, Int64
from tests.toys.box import REACH, Box, only, problems, slopes_of
from tests.toys.trees import LIMITS, RADII, tree_config, worlds

seeds = st.integers(0, 2**31)
law = settings(deadline=None, max_examples=20)
EASY = {"expansions": 400, "reuse__expansions": 100, "refine__iterations": 8, "refine__paths": 3}


Move = Callable[[Float32, Float32], Float32]
ROW = np.zeros(1, np.int64)


@dataclass
class Moving:
    """A world of nothing but its dynamics; counts what it is asked."""

    move: Move
    members: int = 1
    action_size: int = 2
    asked: list[int] = field(default_factory=list)  # rows of each step
    sloped: int = 0

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        self.asked.append(len(z))
        return self.move(z, action), np.zeros(len(z), np.float32)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        self.sloped += 1
        return slopes_of(self.move, z, action)


def world_of(move: Move) -> Any:
    """The part of a world that shooting asks."""
    return Moving(move)


def shot(move: Move, start: Float32, actions: Float32, goal: Float32) -> Shot:
    """One path."""
    return shots(world_of(move), start[None], [actions], goal[None], ROW)[0]


def refined(move: Move, path: Shot, *, unit: float, iterations: int) -> Shot:
    """One path refined."""
    return shooting.refined(world_of(move), [path], unit=unit, iterations=iterations)[0]


def bent(z: Float32, action: Float32) -> Float32:
    """A car: heading z2 turns by action 1, and it drives ahead by action 0."""
    heading = z[:, 2] + np.float32(0.4) * action[:, 1]
    ahead = np.float32(0.2) * action[:, 0]
    moved = [z[:, 0] + ahead * np.cos(heading), z[:, 1] + ahead * np.sin(heading), heading]
    return np.stack(moved, axis=1).astype(np.float32)


def drive(length: int = 12) -> Float32:
    """Full ahead, slowly turning."""
    return np.tile(np.array([0.8, 0.2], np.float32), (length, 1))


def test_the_slope_of_the_end_is_what_changed_actions_do_to_it() -> None:
    start, actions = np.zeros(3, np.float32), drive()
    path = shot(bent, start, actions, start)
    slope = end_slope(slopes_of(bent, path.states[:-1], actions), 3)
    assert slope.shape == (3, 24)
    rng = np.random.default_rng(0)
    change = rng.normal(0, 0.01, actions.shape).astype(np.float32)
    end = shot(bent, start, actions + change, start).states[-1]
    np.testing.assert_allclose(
        end - path.states[-1], slope @ change.ravel().astype(np.float64), atol=2e-3
    )


@law
@given(seeds, st.integers(1, 20))
def test_refining_never_ends_farther_and_keeps_to_the_box(seed: int, length: int) -> None:
    rng = np.random.default_rng(seed)
    start, goal = rng.normal(size=(2, 3)).astype(np.float32)
    actions = rng.uniform(-1, 1, (length, 2)).astype(np.float32)
    before = shot(bent, start, actions, goal)
    after = refined(bent, before, unit=0.2, iterations=6)
    assert after.gap <= before.gap
    assert np.abs(after.actions).max() <= 1
    assert after.actions.shape == actions.shape
    again = shot(bent, start, after.actions, goal)
    np.testing.assert_array_equal(again.states, after.states)
    assert again.gap == after.gap


def test_a_car_is_led_onto_its_goal_from_every_nearby_end() -> None:
    start = np.zeros(3, np.float32)
    reached = shot(bent, start, drive(), start).states[-1]
    for off in np.random.default_rng(1).uniform(-0.2, 0.2, (20, 3)):
        goal = (reached + off).astype(np.float32)
        before = shot(bent, start, drive(), goal)
        after = refined(bent, before, unit=0.2, iterations=10)
        assert after.gap <= shooting.CLOSE * 0.2


def test_what_no_action_can_mend_is_left_as_it_is() -> None:
    def still(z: Float32, action: Float32) -> Float32:
        return z

    start, goal = np.zeros(3, np.float32), np.ones(3, np.float32)
    before = shot(still, start, drive(), goal)
    after = refined(still, before, unit=1.0, iterations=5)
    np.testing.assert_array_equal(after.actions, before.actions)
    nothing = shot(bent, start, drive(0), goal)
    assert refined(bent, nothing, unit=1.0, iterations=5) is nothing
    onto = shot(bent, start, drive(), before.states[-1] * 0)
    there = replace(onto, gap=0.0)
    assert refined(bent, there, unit=1.0, iterations=5).gap == 0


def test_steps_of_the_model_are_counted() -> None:
    """Each step once as it is rolled out; for a slope once there and once back for each latent."""
    start = np.zeros(3, np.float32)
    world = Moving(bent)
    path = shots(world_of(bent), start[None], [drive()], np.ones((1, 3), np.float32), ROW)[0]
    assert path.transitions == 12
    after = shooting.refined(world, [path], unit=0.2, iterations=4)[0]  # type: ignore[arg-type]
    slopes = world.sloped
    assert slopes > 0
    assert after.transitions == 12 + sum(world.asked) + slopes * 12 * (1 + 3)


# ---- with trees -----------------------------------------------------------------------------


def planner(world: Box, *, goal: float = 0.02, **changes: object) -> ShootingPlanner:
    config = tree_config(**{**EASY, **changes})
    return ShootingPlanner(ElastPlanner(world.at, config, LIMITS, RADII), REACH, goal, goal)


def gaps(query: Query, plan: Plan) -> Float32:
    ends = plan.states[np.arange(len(plan.length)), plan.length - 1]
    gap: Float32 = np.linalg.norm(ends - query.goal, axis=1)
    return gap


def test_paths_end_nearer_to_the_goal_than_the_trees() -> None:
    query, open_world = problems(6), Box(wall=False)
    ours = planner(open_world)
    trees, shots = ours.tree.plan(query), ours.plan(query)
    assert (gaps(query, shots) <= 0.02).all()
    assert np.median(gaps(query, trees)) > 0.03
    assert shots.reached.all()


@law
@given(seeds, worlds)
def test_a_plan_is_what_its_actions_do(seed: int, world: Box) -> None:
    query = problems(3, seed)
    plan = planner(world).plan(query)
    here = world.at(query.context)
    np.testing.assert_array_equal(plan.states[:, 0], query.start)
    for b in range(3):
        z = query.start[b : b + 1]
        for t in range(plan.length[b] - 1):
            z, _ = here.step(z, plan.actions[b, t : t + 1], np.array([b]))
            np.testing.assert_array_equal(z[0], plan.states[b, t + 1])


@law
@given(seeds, worlds)
def test_a_row_of_a_batch_equals_its_solo_run(seed: int, world: Box) -> None:
    ours, query = planner(world), problems(3, seed)
    first = ours.plan(query)
    left = np.zeros((3, first.actions.shape[1], 2), np.float32)
    for b in range(3):
        left[b, : first.length[b] - 3] = first.actions[b, 2 : first.length[b] - 1]
    start = np.ascontiguousarray(first.states[:, min(2, first.states.shape[1] - 1)])
    again = replace(query, start=start, left=left, memory=first.memory, seed=query.seed + 1)
    for asked in (query, again):
        together = ours.plan(asked)
        for b in range(3):
            alone = ours.plan(only(asked, b))
            n = together.length[b]
            np.testing.assert_array_equal(together.states[b, :n], alone.states[0])
            np.testing.assert_array_equal(together.actions[b, : n - 1], alone.actions[0])
            for name, calls in vars(alone.cost).items():
                assert getattr(together.cost, name)[b] == calls[0], name
            for name in ("length", "reached"):
                assert getattr(together, name)[b] == getattr(alone, name)[0], name


def test_what_is_left_of_a_plan_that_still_arrives_is_kept_without_a_tree() -> None:
    ours, query = planner(Box(wall=False)), problems(2)
    first = ours.plan(query)
    start = first.states[:, 1] + np.float32(0.01)
    left = np.concatenate([first.actions[:, 1:], np.zeros((2, 5, 2), np.float32)], axis=1)
    for b in range(2):
        left[b, first.length[b] - 2 :] = 0
    second = ours.plan(replace(query, start=start, left=left, memory=first.memory))
    assert second.length.tolist() == (first.length - 1).tolist()
    assert (gaps(query, second) <= 0.02).all()
    assert second.cost.density_calls.tolist() == [0, 0]
    assert [a is b for a, b in zip(second.memory, first.memory, strict=True)] == [True, True]


def test_who_stands_at_the_goal_in_vain_tries_to_come_nearer() -> None:
    query = problems(1)
    ours = planner(Box(wall=False), goal=0.1)
    near = replace(query, start=query.goal + np.array([[0.05, 0]], np.float32))
    plan = ours.plan(near)
    assert gaps(near, plan)[0] <= 0.8 * 0.05
    assert plan.length[0] > 1


def test_who_stands_at_a_goal_that_no_path_comes_nearer_to_goes_away_and_comes_again() -> None:
    ours, query = planner(Box(), goal=0.01), problems(1)

    def path(steps: int, gap: float) -> Shot:
        states = np.zeros((steps + 1, 2), np.float32)
        return Shot(states, drive(steps), states[0], row=0, gap=gap)

    near = replace(query, start=query.goal + np.float32(0.5 * RADII.goal))
    rest, away, farther = path(1, 0.03), path(20, 0.05), path(30, 0.06)
    assert ours._best([rest, farther, away], near, 0) is away
    assert ours._best([rest, path(5, 0.2)], near, 0) is rest  # there is no way about
    assert ours._best([rest, farther, away], query, 0) is rest
    arriving = [path(9, 0.009), path(7, 0.01), path(8, 0.001)]
    assert ours._best([rest, *arriving], near, 0) is arriving[1]


def test_a_model_that_overflows_breaks_nothing() -> None:
    def wild(z: Float32, action: Float32) -> Float32:
        with np.errstate(over="ignore"):
            return z * np.float32(1e30) + action[:, :1] * np.float32(1e30)

    start = np.ones(3, np.float32)
    path = shot(wild, start, drive(), start)
    assert path.gap == np.inf
    with np.errstate(invalid="ignore", over="ignore"):
        assert refined(wild, path, unit=1.0, iterations=3).gap == np.inf


@pytest.mark.parametrize("depths", [[1, 2, 9, 10, 17], [1, 1, 1, 1, 1]])
def test_endings_differ_in_length(depths: list[int]) -> None:
    ours, query = planner(Box(wall=False)), problems(1)
    forest = ours.tree.grow(query).forest
    forest.size[0] = 6
    forest.depth[0, 1:6] = depths
    forest.to_goal[0, :6] = [0, 5, 4, 2, 3, 1]
    bands = {(d - 1) // BAND for d in depths}
    found = endings(forest, 0, 9)
    assert found == ([5, 3, 2] if len(bands) == 3 else [5])
    assert endings(forest, 0, 2) == found[:2]


def test_paths_refined_side_by_side_are_those_refined_alone() -> None:
    world, goal = world_of(bent), np.array([1, 1, 1], np.float32)
    lengths = (3, 12, 7)
    starts, goals = np.zeros((3, 3), np.float32), np.stack([goal, goal * 2, goal])
    paths = shots(world, starts, [drive(n) for n in lengths], goals, np.arange(3))
    together = shooting.refined(world, paths, unit=0.2, iterations=6)
    for path, found in zip(paths, together, strict=True):
        alone = shooting.refined(world, [path], unit=0.2, iterations=6)[0]
        np.testing.assert_array_equal(found.actions, alone.actions)
        np.testing.assert_array_equal(found.states, alone.states)
        assert found.transitions == alone.transitions


class Shut(Box):
    """A world whose support holds nothing: no tree leaves its root."""

    def supported(self, z: Float32, limit: float) -> Any:
        return np.zeros(len(z), np.bool_)


def test_where_no_tree_can_grow_the_policy_leads_towards_the_goal() -> None:
    query = problems(2)
    plan = planner(Shut(wall=False)).plan(query)
    assert (plan.length > 1).all()
    assert (gaps(query, plan) < np.linalg.norm(query.start - query.goal, axis=1)).all()


@pytest.mark.parametrize(("length", "polished"), [(4, True), (40, False)])
def test_a_long_path_is_not_polished_before_its_end_comes(length: int, polished: bool) -> None:
    start, unit = np.zeros(3, np.float32), 0.2
    before = shot(bent, start, drive(length), start)
    goal = before.states[-1] + np.array([0, 0, 0.4 * unit], np.float32)
    before = shot(bent, start, drive(length), goal)
    after = refined(bent, before, unit=unit, iterations=1)
    assert (after.gap < before.gap) == polished
