"""The forward model h_f as dynamics to plan with: it needs no part besides the encoder."""

from __future__ import annotations

from copy import copy

import numpy as np

from elast_cli.inference.dense import DenseNetwork
from elast_cli.inference.slopes import MeanSlopes
from elast_cli.models.tensors import Arrays
from elast_cli.shapes import Float32, Int64


class ForwardDynamics:
    """h_f for B scenarios; satisfies `planners.base.Dynamics`. It knows no variance, which is 0."""

    members = 1

    def __init__(self, arrays: Arrays, action_size: int, device: str = "cpu") -> None:
        """Take the tensors of h_f's network, and the size of actions.

        Args:
            arrays: f32 by name, weights and biases of a network with ReLU.
            action_size: A.
            device: where to compute, in torch's terms.
        """
        self._net = DenseNetwork.of(arrays, device)
        self._slopes = MeanSlopes(self._net.layers)
        self.latent_size, self.action_size = self._net.outputs, action_size
        self.context = np.zeros((0, 0), np.float32)

    def at(self, context: Float32) -> ForwardDynamics:
        """These dynamics for scenarios with contexts [B,C]."""
        dynamics = copy(self)
        dynamics.context = context
        return dynamics

    def step(self, z: Float32, action: Float32, row: Int64) -> tuple[Float32, Float32]:
        """Next latent [M,Z] of h_f, and a variance [M] of 0.

        Arguments as in `Dynamics.step`.
        """
        return z + self._net(self._inputs(z, action, row))[0], np.zeros(len(z), np.float32)

    def slopes(self, z: Float32, action: Float32, row: int) -> Float32:
        """How the next latent of h_f moves with latent and action in scenario `row`: [M,Z,Z+A].

        The last bits of an item may depend on the others in its call.

        Arguments as in `Dynamics.slopes`.
        """
        inputs = self._inputs(z, action, np.full(len(z), row))
        found = self._slopes(inputs, self.latent_size + self.action_size)
        found[:, :, : self.latent_size] += np.eye(self.latent_size, dtype=np.float32)
        return found

    def _inputs(self, z: Float32, action: Float32, row: Int64) -> Float32:
        """[z, a, c] of each item: [M,Z+A+C]."""
        parts = [z, action, self.context[row]] if self.context.shape[1] else [z, action]
        return np.concatenate(parts, axis=1)
