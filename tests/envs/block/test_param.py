"""The block between walls that change: the family of layouts, its scenarios, its pictures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.envs.block.param import BlockParam
from elast_cli.envs.flat.lattice import Lattice
from elast_cli.envs.flat.rectangles import layout_of, rects_of, whole_cells
from elast_cli.envs.flat.shortest_path import UNREACHABLE
from elast_cli.envs.registry import scenarios


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_layout_leaves_lanes_and_gaps_that_the_block_fits_through(seed: int) -> None:
    env = BlockParam()
    config = env._param
    layout = env.sample_layout(np.random.default_rng(seed))
    assert layout.shape == (16,)
    assert layout.dtype == np.float32
    lower, upper = np.array(rects_of(layout, count=4)).reshape(2, 2, 4)
    for left, right in (lower, upper):
        assert left[[1, 3]] == pytest.approx(right[[1, 3]])
        assert config.thickness[0] - 1e-6 <= left[3] - left[1] <= config.thickness[1] + 1e-6
        assert config.gap[0] - 1e-6 <= right[0] - left[2] <= config.gap[1] + 1e-6
        assert (left[0], right[2]) == (0, 1)
        assert min(left[2], 1 - right[0]) >= config.stub - 1e-6
    lanes = (lower[0, 1], upper[0, 1] - lower[0, 3], 1 - upper[0, 3])
    assert min(lanes) >= config.lane - 1e-6


def test_layouts_fill_their_family() -> None:
    env = BlockParam()
    rng = np.random.default_rng(0)
    drawn = np.array([env.sample_layout(rng) for _ in range(2000)]).reshape(-1, 4, 4)
    for wall in (0, 2):
        for low, high in ((0.06, 0.25), (0.25, 0.5), (0.5, 0.7)):
            assert np.mean((drawn[:, wall, 2] >= low) & (drawn[:, wall, 2] < high)) > 0.15
    lanes = np.stack([drawn[:, 0, 1], drawn[:, 2, 1] - drawn[:, 0, 3], 1 - drawn[:, 2, 3]])
    assert lanes.mean(1) == pytest.approx([0.293] * 3, abs=0.01)
    assert abs(np.corrcoef(drawn[:, 0, 2], drawn[:, 2, 2])[0, 1]) < 0.1


def test_a_place_is_free_in_its_own_layout() -> None:
    env = BlockParam()
    rng = np.random.default_rng(0)
    for _ in range(100):
        state, layout = env.sample_start(rng)
        env.set_state(state, layout)
        env.advance(np.zeros(2, dtype=np.float32))
        assert env.state == pytest.approx(state, abs=1e-5)


def test_every_scenario_leads_through_both_gaps_and_a_long_way_round() -> None:
    env = BlockParam()
    still = Lattice([], low=0.05, high=0.95, step=0.07, cell=0.01)
    detours, upward = [], []
    for scenario in scenarios("block-param", "standard", seed=0, count=40):
        env.set_state(scenario.start, scenario.layout)
        assert not env.sees(scenario.start, scenario.goal)
        walls = rects_of(scenario.layout, count=4)
        low, high = sorted((scenario.start[1], scenario.goal[1]))
        assert low < walls[0][1] < walls[2][3] < high
        straight = still.steps(still.field(scenario.goal, env.success_radius), scenario.start)
        assert scenario.shortest is not None
        detours.append(scenario.shortest / straight)
        upward.append(bool(scenario.goal[1] > scenario.start[1]))
    assert np.median(detours) > 1.5
    assert 8 <= sum(upward) <= 32


def test_the_same_places_lie_apart_differently_in_another_layout() -> None:
    env = BlockParam()
    one, other = scenarios("block-param", "standard", seed=0, count=2)
    env.set_state(one.start, one.layout)
    field = env.lattice.field(one.goal, env.success_radius)
    assert env.lattice.steps(field, one.start) == one.shortest
    env.set_state(one.start, other.layout)
    changed = env.lattice.field(one.goal, env.success_radius)
    assert not np.array_equal(field, changed)
    assert (changed != UNREACHABLE).any()


def test_walls_stop_the_block_where_the_layout_has_them() -> None:
    env = BlockParam()
    walls = [(0, 0.3, 0.4, 0.36), (0.6, 0.3, 1, 0.36), (0, 0.6, 0.1, 0.66), (0.3, 0.6, 1, 0.66)]
    layout = layout_of([*walls])
    for x, top in ((0.2, 0.25), (0.5, 0.55), (0.8, 0.25)):
        env.set_state(np.array([x, 0.1], dtype=np.float32), layout)
        for _ in range(10):
            env.advance(np.array([0, 1], dtype=np.float32))
        assert env.state == pytest.approx([x, top], abs=2e-4)
    assert tuple(env.context[64 - 21, 6]) == (52, 58, 70)
    assert (env.context[64 - 21, 32] > 200).all()
    assert np.array_equal(env.frame()[64 - 16, 51], (222, 60, 34))


def test_walls_that_make_no_sense_are_refused() -> None:
    env = BlockParam()
    with pytest.raises(ValueError, match="x_min, y_min, x_max, y_max"):
        env.set_state(env.state, np.zeros(16, dtype=np.float32))


def test_whole_cells_reach_both_ends() -> None:
    rng = np.random.default_rng(0)
    drawn = {whole_cells(rng, 0.04, 0.08, cell=0.01) for _ in range(100)}
    assert drawn == {0.04, 0.05, 0.06, 0.07, 0.08}
