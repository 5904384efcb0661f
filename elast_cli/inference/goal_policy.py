"""Goal-conditioned policies on latents, as functions on arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elast_cli.inference.arrival import ArrivalConfig, steps_left
from elast_cli.inference.dense import DenseNetwork, tanh
from elast_cli.models.stored import Stored
from elast_cli.models.tensors import under
from elast_cli.shapes import Float32


class GoalPolicyCall:
    """`GoalPolicy` on arrays, row by row independent."""

    def __init__(self, policy: Stored, device: str = "cpu") -> None:
        """Take a trained policy."""
        scale = under(policy.arrays, "scale")
        self._mean, self._std = scale["mean"], scale["std"]
        self._net = DenseNetwork.of(under(policy.arrays, "net"), device)

    def __call__(self, z: Float32, goal: Float32, beside: Float32) -> Float32:
        """Latents and goals [B,Z], and what is known beside them [B,X] -> actions [B,A]."""
        scaled = [(x - self._mean) / self._std for x in (z, goal)]
        action: Float32 = tanh(self._net(np.concatenate([*scaled, beside], axis=1))[0])
        return action


@dataclass(frozen=True)
class ArrivingCall:
    """Inverse dynamics over several steps as a policy, given the number of steps left.

    Attributes:
        model: from z, z_g and (1/h, c) to actions.
        config: the rule for h.
        step: length of a median step, in latent units.
        longest: most steps that the model was trained on.
    """

    model: GoalPolicyCall
    config: ArrivalConfig
    step: float
    longest: int

    def __call__(self, z: Float32, goal: Float32, context: Float32) -> Float32:
        """[B,Z], [B,Z], [B,C] -> actions [B,A]."""
        left = steps_left(z, goal, self.config, step=self.step, longest=self.longest)
        pace = (1 / left).astype(np.float32)
        return self.model(z, goal, np.concatenate([pace[:, None], context], axis=1))
