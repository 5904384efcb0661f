"""The cable between walls that change: the family of layouts, its scenarios, its pictures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.envs.cable.param import CableParam
from elast_cli.envs.cable.static import SEGMENTS
from elast_cli.envs.flat.rectangles import layout_of, rects_of
from elast_cli.envs.registry import scenarios

WALL = (52, 58, 70)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_layout_leaves_three_lanes_that_are_open_at_one_end(seed: int) -> None:
    env = CableParam()
    config = env._param
    layout = env.sample_layout(np.random.default_rng(seed))
    assert layout.shape == (8,)
    left, right = np.array(rects_of(layout, count=2))
    for wall in (left, right):
        assert config.thickness[0] - 1e-5 <= wall[2] - wall[0] <= config.thickness[1] + 1e-5
        assert config.reach[0] - 1e-5 <= wall[3] - wall[1] <= config.reach[1] + 1e-5
        assert (wall[1] == 0) != (wall[3] == 1)
    assert min(left[0], right[0] - left[2], 1 - right[2]) >= config.lane - 1e-5


def test_walls_come_from_below_and_from_above_alike() -> None:
    env = CableParam()
    rng = np.random.default_rng(0)
    drawn = np.array([env.sample_layout(rng) for _ in range(400)]).reshape(-1, 2, 4)
    below = drawn[:, :, 1] == 0
    assert np.abs(below.mean(0) - 0.5).max() < 0.08
    assert abs((below[:, 0] == below[:, 1]).mean() - 0.5) < 0.08
    assert np.ptp(drawn[:, 0, 0]) > 0.12


def test_starts_touch_no_wall_of_their_own_layout() -> None:
    env = CableParam()
    rng = np.random.default_rng(0)
    for _ in range(100):
        state, layout = env.sample_start(rng)
        env.set_state(state, layout)
        assert env.clearance(state.reshape(-1, 2)) >= env.config.radius


def test_start_and_goal_are_free_in_one_layout_and_layouts_differ() -> None:
    env = CableParam()
    drawn = scenarios("cable-param", "standard", seed=0, count=20)
    for scenario in drawn:
        env.set_state(scenario.start, scenario.layout)
        for nodes in (scenario.start, scenario.goal):
            assert env.clearance(nodes.reshape(-1, 2)) > 0.5 * env.config.radius
    assert len({scenario.layout.tobytes() for scenario in drawn}) == len(drawn)


def test_walls_stop_the_cable_where_the_layout_has_them_and_the_context_shows_them() -> None:
    env = CableParam()
    layout = layout_of([(0.3, 0, 0.35, 0.5), (0.7, 0.5, 0.75, 1)])
    along = np.linspace(0, env.config.length, SEGMENTS + 1)
    reached = []
    for height in (0.05, 0.55):
        upright = np.stack([np.full_like(along, 0.15), height + along], axis=1)
        env.set_state(upright.astype(np.float32).ravel(), layout)
        for _ in range(8):
            env.advance(np.array([1, 0], dtype=np.float32))
        reached.append(float(env.state[0]))
    assert reached[0] == pytest.approx(0.28, abs=5e-3)  # at the wall
    assert reached[1] > 0.5  # above it
    assert tuple(env.context[60, 20]) == WALL
    assert tuple(env.context[4, 46]) == WALL
    assert (env.context[4, 20] > 230).all()
    assert (env.context[60, 46] > 230).all()
