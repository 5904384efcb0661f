"""The block with a stream: what it carries away, the way round, shortest steps, pictures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.envs.block.asym import BlockAsym
from elast_cli.envs.flat.lattice import Lattice
from elast_cli.envs.registry import scenarios
from elast_cli.envs.scenario import empty_layout

STREAM = (150, 198, 232)


def at(x: float, y: float) -> BlockAsym:
    """A task with the block's centre at (x, y)."""
    env = BlockAsym()
    env.set_state(np.array([x, y], dtype=np.float32), empty_layout())
    return env


def push(env: BlockAsym, x: float, y: float, steps: int = 1) -> np.ndarray:
    """Where an action held for some steps leads."""
    for _ in range(steps):
        env.advance(np.array([x, y], dtype=np.float32))
    return env.state


def test_the_stream_adds_its_drift_to_what_the_action_does() -> None:
    assert push(at(0.85, 0.5), 0, 0) == pytest.approx([0.85, 0.4], abs=1e-6)
    assert push(at(0.85, 0.5), -1, -1) == pytest.approx([0.78, 0.33], abs=1e-6)
    assert push(at(0.85, 0.5), 0.5, 1) == pytest.approx([0.885, 0.47], abs=1e-6)


def test_outside_the_stream_the_block_moves_by_the_action_alone() -> None:
    assert push(at(0.85, 0.9), 0, 0) == pytest.approx([0.85, 0.9], abs=1e-6)
    assert push(at(0.5, 0.1), 1, 0) == pytest.approx([0.57, 0.1], abs=1e-6)
    assert push(at(0.1, 0.5), 0, 1) == pytest.approx([0.1, 0.57], abs=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_actions_lead_up_the_stream(seed: int) -> None:
    rng = np.random.default_rng(seed)
    env = at(float(rng.uniform(0.75, 0.9)), float(rng.uniform(0.06, 0.7)))
    top = max(float(env.state[1]), env.config.walls[0][1] + env.config.displacement)
    for _ in range(60):
        before = env.state
        after = push(env, rng.choice([-1.0, 0.0, 1.0]), rng.choice([0.5, 1.0]))
        if env.in_stream(before):
            assert after[1] <= before[1] - 0.03 + 1e-5
            assert not env.against_stream(before, after)
        if after[0] < 0.7:
            break
        assert after[1] <= top + 1e-5


def test_the_block_is_at_rest_again_below_the_stream() -> None:
    env = at(0.85, 0.7)
    push(env, 0, 0, steps=20)
    assert not env.in_stream(env.state)
    assert push(env, 0, 0) == pytest.approx([0.85, 0.2], abs=1e-5)


def test_a_transition_up_the_stream_is_recognised() -> None:
    def against(x: float, y: float, dx: float, dy: float, tolerance: float = 0.02) -> bool:
        before = np.array([x, y], dtype=np.float32)
        after = np.array([x + dx, y + dy], dtype=np.float32)
        return BlockAsym().against_stream(before, after, tolerance=tolerance)

    assert against(0.85, 0.5, 0.0, 0.05)
    assert against(0.85, 0.5, 0.1, 0.03)
    assert not against(0.85, 0.5, 0.0, -0.05)
    assert not against(0.85, 0.5, 0.07, 0.01)
    assert against(0.85, 0.5, 0.07, 0.01, tolerance=0.005)
    assert not against(0.1, 0.5, 0.0, 0.07)  # calm there
    assert not against(0.85, 0.18, 0.0, 0.07)  # one step into the stream is possible


def test_every_scenario_is_near_against_the_stream_and_far_round() -> None:
    env = BlockAsym()
    still = Lattice(env._grown, low=0.05, high=0.95, step=0.07, cell=0.005)
    for scenario in scenarios("block-asym", "upstream", seed=0, count=30):
        assert env.sees(scenario.start, scenario.goal)
        assert not env.in_stream(scenario.goal)
        assert scenario.goal[1] > 0.78 > 0.46 > scenario.start[1]
        field = still.field(scenario.goal, env.success_radius)
        assert scenario.shortest is not None
        assert still.steps(field, scenario.start) < scenario.shortest / 2


def test_the_picture_shows_the_stream_as_a_band_under_the_block() -> None:
    frame = at(0.3, 0.1).frame()
    assert tuple(frame[32, 60]) == STREAM
    assert (frame[4, 60] > 230).all()
    assert (frame[60, 60] > 230).all()
    assert tuple(at(0.85, 0.5).frame()[32, 54]) == (222, 60, 34)
