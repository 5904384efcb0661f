"""Where H_f has seen data: the ensemble with the support of the latents it was trained on."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from elast_cli.models.ensemble.config import EnsembleConfig
from elast_cli.models.ensemble.net import DynamicsEnsemble
from elast_cli.models.nets import QuantileTable


class Support(nn.Module):
    """Encoded training states: a latent far from all of them is outside the data's support.

    The distances are calibrated on H_f's predictions of held-out transitions, which is what the
    search tests: predictions err more where data are scarce, as in a narrow passage.
    """

    latents: Tensor
    rows: Tensor
    states: Tensor

    def __init__(self, size: int, latent_size: int, state_size: int) -> None:
        """Make room for the states; they are filled in after training.

        Args:
            size: number of states.
            latent_size: Z.
            state_size: S, of a true state.
        """
        super().__init__()
        self.register_buffer("latents", torch.zeros(size, latent_size))
        self.register_buffer("rows", torch.zeros(size, dtype=torch.int64))
        self.register_buffer("states", torch.zeros(size, state_size))
        self.distance_quantiles = QuantileTable()

    def distance(self, z: Tensor) -> Tensor:
        """Euclidean distance [M] of each latent [M,Z] to its nearest training latent."""
        parts = [torch.cdist(part, self.latents).amin(1) for part in z.split(2048)]
        return torch.cat(parts)

    def nearest(self, z: Tensor) -> Tensor:
        """Index [M] of the nearest training latent: decodes latents for people to look at."""
        parts = [torch.cdist(part, self.latents).argmin(1) for part in z.split(2048)]
        return torch.cat(parts)


class SupportedDynamics(nn.Module):
    """H_f and its support, published as one artifact: `ensemble`."""

    def __init__(
        self,
        config: EnsembleConfig,
        *,
        latent_size: int,
        action_size: int,
        context_size: int,
        state_size: int,
    ) -> None:
        """Build an untrained ensemble and an empty support.

        Args:
            config: of the networks, and the size of the support.
            latent_size: Z.
            action_size: A.
            context_size: C; 0 where a task has no context.
            state_size: S, of a true state.
        """
        super().__init__()
        self.config = config
        self.ensemble = DynamicsEnsemble(config, latent_size, action_size, context_size)
        self.support = Support(config.support_size, latent_size, state_size)
