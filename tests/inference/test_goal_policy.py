"""Goal-conditioned policies on arrays are the networks that were trained."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from elast_cli.control.base import Task
from elast_cli.inference.arrival import ArrivalConfig, steps_left
from elast_cli.inference.goal_policy import ArrivingCall, GoalPolicyCall
from elast_cli.inference.pixels import PixelFrames, PixelPolicyCall
from elast_cli.models.files import stored
from elast_cli.models.goal_policy.pixel_gcbc.net import PixelGoalPolicy
from elast_cli.shapes import FRAMES, Float32, Uint8
from tests.toys.models import ACTION, CONTEXT, LATENT, models, trained


def latents(rows: int) -> list[Float32]:
    """Latents, goals and contexts."""
    rng = np.random.default_rng(0)
    return [rng.standard_normal((rows, size), np.float32) for size in (LATENT, LATENT, CONTEXT)]


def test_a_policy_on_arrays_is_the_module() -> None:
    model, items = models()["gcbc"], latents(9)
    call = GoalPolicyCall(stored(trained(model)))
    expected = model(*map(torch.from_numpy, items))
    np.testing.assert_allclose(call(*items), expected, rtol=1e-4, atol=1e-6)
    for row in range(9):  # to the bit
        alone = call(*(x[row : row + 1] for x in items))
        np.testing.assert_array_equal(alone[0], call(*items)[row])


def test_inverse_dynamics_is_given_the_inverse_of_the_steps_left() -> None:
    model, (z, goal, context) = models()["gcidm"], latents(5)
    rule = ArrivalConfig()
    call = ArrivingCall(GoalPolicyCall(stored(trained(model))), rule, step=0.5, longest=7)
    left = steps_left(z, goal, rule, step=0.5, longest=7)
    assert len(set(left.tolist())) > 1
    beside = np.concatenate([1 / left[:, None], context], 1).astype(np.float32)
    expected = model(*map(torch.from_numpy, (z, goal, beside)))
    np.testing.assert_allclose(call(z, goal, context), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (ArrivalConfig(), [1, 1, 3, 10]),
        (ArrivalConfig(pace=2.0), [1, 2, 5, 10]),
        (ArrivalConfig(rule="longest"), [10, 10, 10, 10]),
    ],
)
def test_steps_left_are_those_of_the_straight_way(
    config: ArrivalConfig, expected: list[int]
) -> None:
    z, goal = np.zeros((4, 2), np.float32), np.zeros((4, 2), np.float32)
    goal[:, 1] = [0, 0.5, 1.25, 50]  # steps of half a unit
    assert steps_left(z, goal, config, step=0.5, longest=10).tolist() == expected


@pytest.mark.parametrize("shown", [False, True])
def test_a_policy_on_images_sees_what_it_was_trained_on(shown: bool) -> None:
    model = models()["pixel_gcbc"]
    assert isinstance(model, PixelGoalPolicy)
    rng = np.random.default_rng(0)
    goal, frames = rng.integers(256, size=(2, 3, FRAMES, 64, 64, 3), dtype=np.uint8)
    images = rng.integers(256, size=(3, 64, 64, 3), dtype=np.uint8) if shown else None
    context = latents(3)[2]
    estimator = PixelFrames(model.config.pool)
    seen_goal, state = estimator.begin(Task(goal, np.arange(3), images))
    seen, _ = estimator.update(state, frames, None)
    found = PixelPolicyCall(model)(seen, seen_goal, context)

    def features(of: Uint8) -> torch.Tensor:
        return model.preprocess(torch.from_numpy(of))

    less = 0 if images is None else features(images)
    stack = torch.stack([features(frames[:, i]) - less for i in range(FRAMES)], dim=1)
    expected = model(stack, features(goal[:, -1]) - less, torch.from_numpy(context))
    assert found.shape == (3, ACTION)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
