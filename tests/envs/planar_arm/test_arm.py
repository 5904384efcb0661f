"""The planar arm: kinematics, contact, pictures, layouts and shortest steps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.envs.flat.shortest_path import UNREACHABLE
from elast_cli.envs.planar_arm.arm import OBSTACLES, PlanarArm
from elast_cli.envs.planar_arm.collision import collides
from elast_cli.envs.registry import scenarios
from elast_cli.envs.scenario import Scenario

FAR = np.array([0.06, 0.06, 0.06, 0.94, 0.06, 0.06, 0.94, 0.94, 0.06], dtype=np.float32)


def at(shoulder: float, elbow: float, layout: np.ndarray = FAR) -> PlanarArm:
    """A task with the joints at these angles, the obstacles out of reach if not given."""
    env = PlanarArm()
    env.set_state(np.array([shoulder, elbow], dtype=np.float32), layout)
    return env


def push(env: PlanarArm, first: float, second: float, steps: int = 1) -> np.ndarray:
    """Angles after an action held for some steps."""
    for _ in range(steps):
        env.advance(np.array([first, second], dtype=np.float32))
    return env.state


def clearance(env: PlanarArm) -> float:
    """Least distance of either link's skin from an obstacle, from 400 places on each."""
    elbow, tip = env.ends(env.state)
    base = np.array([0.5, 0.5])
    share = np.linspace(0, 1, 400)[:, None]
    places = np.concatenate([base + share * (elbow - base), elbow + share * (tip - elbow)])
    skins = env._obstacles[:, 2] + env.config.radius
    gaps = np.linalg.norm(places[:, None] - env._obstacles[:, :2], axis=2).min(0) - skins
    return float(gaps.min())


def test_the_links_end_where_trigonometry_says() -> None:
    env = at(0, 0)
    assert env.ends(env.state) == pytest.approx(np.array([[0.74, 0.5], [0.96, 0.5]]))
    assert env.ends(np.array([np.pi / 2, -np.pi / 2])) == pytest.approx(
        np.array([[0.5, 0.74], [0.72, 0.74]])
    )


def test_an_action_turns_both_joints_and_no_motion_is_left() -> None:
    env = at(0.5, -1)
    assert push(env, 1, -0.5) == pytest.approx([0.7, -1.1], abs=1e-6)
    assert push(env, 0, 0) == pytest.approx([0.7, -1.1], abs=1e-6)


def test_joints_stop_at_their_limits_and_the_other_goes_on() -> None:
    env = at(2.75, 0)
    assert push(env, 1, 1) == pytest.approx([2.8, 0.2], abs=1e-6)
    assert push(env, -1, 0) == pytest.approx([2.6, 0.2], abs=1e-6)


def test_the_distance_is_that_of_the_link_end_that_is_farther_off() -> None:
    env = at(0, 0)
    assert env.distance(np.array([0.0, 0.0]), np.array([0.0, 0.1])) == pytest.approx(
        2 * 0.22 * np.sin(0.05), abs=1e-6
    )
    folded = env.distance(np.array([0.0, 2.8]), np.array([0.3, 2.8]))
    assert folded == pytest.approx(2 * 0.24 * np.sin(0.15), abs=1e-6)  # the elbow's, not the tip's


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_actions_lead_into_an_obstacle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    env = PlanarArm()
    env.set_state(*env.sample_start(rng))
    assert clearance(env) > -1e-6
    for _ in range(40):
        first, second = rng.choice([-1.0, 0.0, 1.0], 2)
        push(env, first, second, steps=2)
        assert clearance(env) > -1e-6
        assert np.abs(env.state).max() <= env.config.limit + 1e-6


def test_a_link_stops_at_an_obstacle_and_slides_along_it() -> None:
    layout = FAR.copy()
    layout[:3] = (0.5, 0.87, 0.07)
    env = at(0.5, 0, layout)
    blocked = push(env, 1, 0, steps=10)
    assert blocked[0] < 1.5
    assert 0 <= clearance(env) < 0.015
    passed = push(env, 1, -1, steps=20)  # folding lets it go on
    assert passed[0] > 2.5


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_layouts_are_out_of_the_first_links_reach_apart_and_wholly_seen(seed: int) -> None:
    env = PlanarArm()
    layout = env.sample_layout(np.random.default_rng(seed))
    assert layout.shape == (3 * OBSTACLES,)
    circles = layout.reshape(-1, 3)
    for x, y, r in circles:
        assert 0.06 - 1e-6 <= r <= 0.09 + 1e-6
        away = np.hypot(x - 0.5, y - 0.5)
        assert away - r > env.config.lengths[0] + env.config.radius
        assert away + r <= 0.5 + 1e-6
    for one, other in itertools.combinations(circles, 2):
        assert np.hypot(*(one - other)[:2]) - one[2] - other[2] >= env.config.spacing - 1e-6


def test_a_folded_arm_passes_every_layout() -> None:
    rng = np.random.default_rng(0)
    env = PlanarArm()
    for _ in range(30):
        env.set_state(np.array([-2.8, 2.8], dtype=np.float32), env.sample_layout(rng))
        assert push(env, 1, 0, steps=28) == pytest.approx([2.8, 2.8], abs=1e-5)


def test_the_picture_shows_links_base_and_obstacles_the_right_way_up() -> None:
    frame = at(np.pi / 2, -np.pi / 2).frame().astype(int)
    link, other = frame[64 - 40, 32], frame[64 - 48, 40]
    assert tuple(link) == (30, 90, 200)
    assert tuple(other) == (236, 120, 20)
    assert tuple(frame[31, 31]) == (120, 124, 132)
    assert tuple(frame[64 - 4, 4]) == (52, 58, 70)  # x = y = .06
    assert tuple(frame[4, 60]) == (52, 58, 70)
    assert (frame[4, 4] > 230).all()


def test_the_whole_arm_is_always_seen() -> None:
    env = PlanarArm()
    for shoulder in np.linspace(-2.8, 2.8, 50):
        _, tip = env.ends(np.array([shoulder, 0.0]))
        assert env.config.radius < tip.min()
        assert tip.max() < 1 - env.config.radius


def test_postures_that_are_apart_look_different() -> None:
    """No two postures look alike: also not with the elbow on either side or at the limits."""
    rng = np.random.default_rng(0)
    env = at(0, 0)
    drawn = rng.uniform(-2.8, 2.8, (150, 2))
    mirrored = np.array([[2.8, e] for e in (-2.0, 0.0, 2.0)] + [[-2.8, e] for e in (-2, 0, 2)])
    postures = np.concatenate([drawn, mirrored])
    pictures, ends = [], []
    for posture in postures:
        env.set_state(posture.astype(np.float32), FAR)
        pictures.append(env.frame().astype(float).ravel())
        ends.append(env.ends(posture))
    for i, j in itertools.combinations(range(len(postures)), 2):
        apart = np.hypot(*(ends[i] - ends[j]).T).max()
        change = np.abs(pictures[i] - pictures[j]).sum() / 255
        if apart > env.success_radius:
            assert change > 15


def test_a_turn_of_a_fiftieth_of_a_degree_changes_the_picture() -> None:
    one, other = at(0.3, 0.7).frame(), at(0.3004, 0.7).frame()
    assert not np.array_equal(one, other)


def greedy_steps(env: PlanarArm, scenario: Scenario, limit: int) -> int | None:
    """Steps to success when the field of shortest steps is followed with the true kinematics."""
    env.set_state(scenario.start, scenario.layout)
    grid = env.grid()
    field = grid.field(env._within_reach(scenario.goal)).astype(float)
    field[field == UNREACHABLE] = np.nan
    near = np.lib.stride_tricks.sliding_window_view(
        np.pad(field, 2, constant_values=np.nan), (5, 5)
    ).reshape(*field.shape, 25)
    smooth = np.nansum(near, -1) / np.maximum((~np.isnan(near)).sum(-1), 1)
    smooth[np.isnan(field)] = np.inf
    choices = np.linspace(-1, 1, 11)
    for step in range(1, limit + 1):
        before = env.state
        best, chosen = np.inf, before
        for action in itertools.product(choices, choices):
            env.set_state(before, scenario.layout)
            end = push(env, *action)
            column, row = np.round((end - grid.low) / grid.cell).astype(int)
            value = smooth[row, column]
            if env.distance(end, scenario.goal) <= env.success_radius:
                value = -1
            if value < best:
                best, chosen = value, end
        env.set_state(chosen, scenario.layout)
        if best == -1:
            return step
    return None


def test_shortest_steps_are_met_and_hardly_ever_beaten_by_the_true_kinematics() -> None:
    env = PlanarArm()
    over = []
    for scenario in scenarios("planar-arm", "standard", seed=11, count=15, domain="scenario-val"):
        assert scenario.shortest is not None
        steps = greedy_steps(env, scenario, limit=80)
        assert steps is not None
        over.append(steps - scenario.shortest)
    assert min(over) >= -1
    assert np.median(over) <= 1
    assert max(over) <= 4


def test_straight_motion_never_solves_a_scenario() -> None:
    env = PlanarArm()
    for scenario in scenarios("planar-arm", "standard", seed=0, count=30):
        env.set_state(scenario.start, scenario.layout)
        assert not env.sees(scenario.start, scenario.goal)
        circles = scenario.layout.astype(float).reshape(-1, 3)
        for angles in (scenario.start, scenario.goal):
            assert not collides(
                float(angles[0]), float(angles[1]), env._lengths, env.config.radius, circles
            )
