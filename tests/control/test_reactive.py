"""A policy in closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elast_cli.control.reactive import Reactive
from elast_cli.shapes import Float32
from tests.toys.control import Brightness, frames_of, no_context, task_of


def towards(z: Float32, goal: Float32, context: Float32) -> Float32:
    """The exact policy of a world where z' = z + a + c."""
    return goal - z - context


def test_the_policy_is_asked_for_one_action_at_every_step() -> None:
    controller = Reactive(Brightness(), no_context, towards)
    state = controller.begin(task_of(5, 3))
    running = np.array([True, False])
    for here, expected in (((2, 3), (1, 0)), ((5, 2), (0, 1)), ((6, 9), (-1, -1))):
        action, state = controller.act(state, frames_of(*here), running)
        assert action[:, 0].tolist() == list(expected)  # in the action box
        assert action.dtype == np.float32
    assert state.log.plans.tolist() == [0, 0]
    assert state.log.cost.policy_calls.tolist() == [3, 0]
    assert state.log.cost.transitions.tolist() == [0, 0]


def test_a_policy_is_given_the_contexts_and_sees_frames_less_their_images() -> None:
    controller = Reactive(Brightness(), lambda _images, rows: np.full((rows, 1), 0.25), towards)
    context = frames_of(1)[:, 0]
    state = controller.begin(replace(task_of(5), context=context))
    assert state.goal.tolist() == [[4]]
    action, _ = controller.act(state, frames_of(5), np.ones(1, bool))
    assert action.tolist() == [[-0.25]]
