"""The forward model rolled out for shooting planners."""

from __future__ import annotations

import torch
from torch import Tensor

from elast_cli.models.nets import ForwardModel


class CemRollout:
    """h_f rolled out for CEM: K action sequences of one scenario at a time."""

    def __init__(self, model: ForwardModel, action_size: int) -> None:
        self.net = model.net
        self.latent_size = model.latent_size
        self.action_size = action_size
        self.members = 1

    @torch.inference_mode()
    def __call__(self, z: Tensor, actions: Tensor, context: Tensor) -> Tensor:
        """From z [Z] under actions [K,H,A] in context [C] to latents [K,H,Z] on the CPU."""
        samples, horizon, size = actions.shape
        device = next(self.net.parameters()).device
        actions = actions.to(device)
        x = torch.empty(samples, self.latent_size + size + len(context), device=device)
        x[:, : self.latent_size] = z
        x[:, self.latent_size + size :] = context
        path = torch.empty(samples, horizon, self.latent_size, device=device)
        for t in range(horizon):
            x[:, self.latent_size : self.latent_size + size] = actions[:, t]
            x[:, : self.latent_size] += self.net(x)
            path[:, t] = x[:, : self.latent_size]
        return path.cpu()
