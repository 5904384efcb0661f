"""The block: walls, sliding, pictures and shortest steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.envs.block.config import BlockConfig
from elast_cli.envs.block.static import Block
from elast_cli.envs.flat.lattice import Lattice
from elast_cli.envs.flat.shortest_path import UNREACHABLE
from elast_cli.envs.registry import make, scenarios
from elast_cli.envs.scenario import Scenario, empty_layout

BLOCK = (222, 60, 34)
WALL = (52, 58, 70)


def at(x: float, y: float, config: BlockConfig | None = None) -> Block:
    """A task with the block's centre at (x, y)."""
    env = Block(config)
    env.set_state(np.array([x, y], dtype=np.float32), empty_layout())
    return env


def push(env: Block, x: float, y: float, steps: int = 1) -> np.ndarray:
    """Where an action held for some steps leads."""
    for _ in range(steps):
        env.advance(np.array([x, y], dtype=np.float32))
    return env.state


def overlap(env: Block) -> float:
    """How deep the block is in a wall or over the border, in workspace widths."""
    x, y = env.state
    size = env.config.half_size
    depths = [
        min(x + size - a, c - x + size, y + size - b, d - y + size)
        for a, b, c, d in env.config.walls
    ]
    return float(max(*depths, size - min(x, y), max(x, y) + size - 1))


def test_an_action_moves_the_block_by_its_displacement() -> None:
    assert push(at(0.5, 0.5), 1, 0) == pytest.approx([0.57, 0.5], abs=1e-6)
    assert push(at(0.5, 0.5), -0.5, 0.25) == pytest.approx([0.465, 0.5175], abs=1e-6)
    assert push(at(0.5, 0.5), 0, 0, steps=5) == pytest.approx([0.5, 0.5], abs=1e-7)


def test_the_block_keeps_no_speed() -> None:
    env = at(0.5, 0.5)
    moved = push(env, 1, 0)
    assert push(env, 0, 0) == pytest.approx(moved, abs=1e-7)


def test_the_block_slides_along_a_wall() -> None:
    env = at(0.4, 0.24)
    end = push(env, 1, 1, steps=3)
    assert end[0] == pytest.approx(0.61, abs=1e-4)
    assert end[1] == pytest.approx(0.26, abs=2e-3)


def test_the_block_rests_against_a_wall_that_it_is_pushed_into() -> None:
    env = at(0.4, 0.2)
    assert push(env, 0, 1, steps=10) == pytest.approx([0.4, 0.26], abs=2e-4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_walls_are_never_crossed_by_the_strongest_actions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    env = Block()
    env.set_state(*env.sample_start(rng))
    field = env.lattice.field(env.state, env.success_radius)
    for _ in range(60):
        before = env.state
        push(env, *rng.choice([-1.0, 0.0, 1.0], 2))
        assert overlap(env) <= env.config.displacement / env.config.substeps + 2e-4
        # Nothing is jumped over: one step changes the steps to a fixed place by at most one.
        steps = [env.lattice.steps(field, place) for place in (before, env.state)]
        assert abs(steps[1] - steps[0]) <= 2


def test_the_corridor_is_wide_enough_for_the_block_and_shorter_ways_are_shut() -> None:
    env = at(0.9, 0.2)
    assert push(env, 0, 1, steps=4)[1] > 0.4
    env = at(0.1, 0.2)
    assert push(env, 0, 1, steps=4)[1] < 0.27


def test_free_places_touch_no_wall_and_lie_in_every_corridor() -> None:
    env = Block()
    rng = np.random.default_rng(0)
    places = []
    for _ in range(300):
        state, layout = env.sample_start(rng)
        env.set_state(state, layout)
        assert overlap(env) <= 1e-7
        places.append(state)
    heights = np.array(places)[:, 1]
    assert min((heights < 0.3).mean(), ((heights > 0.4) & (heights < 0.6)).mean()) > 0.2
    assert (heights > 0.7).mean() > 0.2


def test_the_picture_shows_block_and_walls_the_right_way_up() -> None:
    frame = at(0.25, 0.2).frame()
    assert tuple(frame[64 - 13, 16]) == BLOCK  # x = .25, y = .2
    assert tuple(frame[64 - 21, 8]) == WALL  # the lower wall begins at the left
    assert tuple(frame[64 - 43, 60]) == WALL  # the upper wall ends at the right
    assert (frame[64 - 21, 60] > 200).all()
    assert (frame[64 - 43, 4] > 200).all()


def test_a_move_of_a_fifteenth_of_a_pixel_changes_the_picture() -> None:
    assert not np.array_equal(at(0.5, 0.5).frame(), at(0.501, 0.5).frame())
    assert not np.array_equal(at(0.5, 0.5).frame(), at(0.5, 0.501).frame())


@given(st.floats(0.06, 0.94), st.floats(0.45, 0.55))
def test_the_picture_holds_as_much_block_wherever_it_is(x: float, y: float) -> None:
    env = at(x, y)
    painted = (244.0 - env.frame()[:, :, 0].astype(float))[20:44].sum()
    empty = (244.0 - env._background[1][:, :, 0])[20:44].sum()
    assert painted - empty == pytest.approx((0.1 * 64) ** 2 * (244 - 222), abs=45)


def greedy_steps(env: Block, scenario: Scenario, limit: int) -> int | None:
    """Steps to success when the field of shortest steps is followed in the physics engine."""
    env.set_state(scenario.start, scenario.layout)
    grid = np.linspace(-1, 1, 2 * env.lattice.reach + 1)
    actions = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    lattice, radius = env.lattice, env.success_radius
    field = lattice.field(scenario.goal, radius).astype(float)
    field[field == UNREACHABLE] = np.nan
    around = np.pad(field, 2, constant_values=np.nan)
    near = np.lib.stride_tricks.sliding_window_view(around, (5, 5)).reshape(*field.shape, 25)
    filled = np.where(np.isnan(near), 0, near).sum(-1)
    smooth = filled / np.maximum((~np.isnan(near)).sum(-1), 1)
    smooth[np.isnan(field)] = np.inf
    for step in range(1, limit + 1):
        ends = lattice.after(env.state, actions)
        cells = np.round((ends - lattice.low) / lattice.cell).astype(int)
        values = smooth[cells[:, 1], cells[:, 0]]
        values[np.hypot(*(ends - scenario.goal).T) <= radius - 1e-4] = -1
        push(env, *actions[values.argmin()])
        if env.distance(env.state, scenario.goal) <= radius:
            return step
    return None


@pytest.mark.parametrize(
    ("name", "level", "count"),
    [
        ("block-s", "medium", 20),
        ("block-s", "hard", 12),
        ("block-asym", "upstream", 12),
        ("block-param", "standard", 20),
    ],
)
def test_shortest_steps_are_met_and_never_beaten_in_the_physics_engine(
    name: str, level: str, count: int
) -> None:
    env = make(name)
    assert isinstance(env, Block)
    for scenario in scenarios(name, level, seed=11, count=count, domain="scenario-val"):
        assert scenario.shortest is not None
        steps = greedy_steps(env, scenario, limit=60)
        assert steps is not None
        assert scenario.shortest <= steps <= scenario.shortest + 2


def test_a_finer_lattice_counts_the_same_shortest_steps() -> None:
    env = Block()
    coarse = Lattice(env._grown, low=0.05, high=0.95, step=0.07, cell=0.01)
    for scenario in scenarios("block-s", "hard", seed=3, count=10):
        field = coarse.field(scenario.goal, env.success_radius)
        assert scenario.shortest is not None
        assert abs(coarse.steps(field, scenario.start) - scenario.shortest) <= 1


@pytest.mark.parametrize("level", ["medium", "hard"])
def test_a_straight_line_never_solves_a_scenario(level: str) -> None:
    env = Block()
    for scenario in scenarios("block-s", level, seed=0, count=20):
        assert not env.sees(scenario.start, scenario.goal)


def test_hard_scenarios_join_the_two_ends_in_either_direction() -> None:
    low, high = Block().config.ends
    upward = []
    for scenario in scenarios("block-s", "hard", seed=0, count=20):
        places = sorted((scenario.start, scenario.goal), key=lambda place: float(place[1]))
        for place, end in zip(places, (low, high), strict=True):
            assert (place >= np.array(end[:2], dtype=np.float32)).all()
            assert (place <= np.array(end[2:], dtype=np.float32)).all()
        upward.append(bool(scenario.goal[1] > scenario.start[1]))
    assert 4 <= sum(upward) <= 16
