"""h_f as dynamics to plan with, against the module that is trained and torch's slopes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.inference.forward_dynamics import ForwardDynamics
from elast_cli.models.files import arrays_of
from tests.toys.models import ACTION, CONTEXT, LATENT, models


@pytest.mark.parametrize("contexts", [0, CONTEXT])
def test_steps_and_slopes_are_those_of_the_trained_module_in_each_context(contexts: int) -> None:
    encoder: Any = models(context=contexts)["encoder"]
    rng = np.random.default_rng(0)
    z, action, context = (
        rng.normal(size=shape).astype(np.float32)
        for shape in ((5, LATENT), (5, ACTION), (2, contexts))
    )
    dynamics = ForwardDynamics(arrays_of(encoder.dynamics.net), ACTION).at(context)
    row = np.array([0, 1, 1, 0, 1])
    landed, variance = dynamics.step(z, action, row)
    inputs = [torch.from_numpy(x) for x in (z, action, context[row])]
    np.testing.assert_allclose(landed, encoder.dynamics(*inputs), atol=1e-5)
    assert not variance.any()
    assert (dynamics.latent_size, dynamics.action_size, dynamics.members) == (LATENT, ACTION, 1)

    def move(joint: torch.Tensor) -> torch.Tensor:
        z_and_action = joint[None, :LATENT], joint[None, LATENT:]
        moved: torch.Tensor = encoder.dynamics(*z_and_action, torch.from_numpy(context[1:]))[0]
        return moved

    slopes = dynamics.slopes(z, action, 1)
    joint = torch.cat(inputs[:2], dim=1)
    expected = np.stack([torch.func.jacrev(move)(one).numpy() for one in joint])
    np.testing.assert_allclose(slopes, expected, atol=1e-5)
