"""A dataset in latent space, and the training loop of the models on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.models.fit import fit
from elast_cli.models.nets import LatentScale
from elast_cli.models.part import FitConfig, Setting, Sizes

VALIDATION_ROWS = 2048
CALIBRATION_ROWS = 50_000


@dataclass(frozen=True)
class LatentData:
    """A whole dataset encoded.

    Attributes:
        z, action, context: latents [N,Z], actions [N,A], contexts [N,C].
        state: true states [N,S], kept only so that people can read plans and probes.
        train, val: rows at which a transition starts.
    """

    z: Tensor
    action: Tensor
    context: Tensor
    state: Tensor
    train: Tensor
    val: Tensor

    @property
    def sizes(self) -> Sizes:
        """Sizes of the models trained on this data."""
        return Sizes(
            latent=self.z.shape[1],
            action=self.action.shape[1],
            context=self.context.shape[1],
            state=self.state.shape[1],
        )

    def transitions(self, rows: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """z [M,Z], a [M,A], c [M,C], z' [M,Z] of the transitions that start at `rows` [M]."""
        return self.z[rows], self.action[rows], self.context[rows], self.z[rows + 1]

    def batch(self, rng: np.random.Generator, size: int) -> Tensor:
        """Rows [size] of training transitions, uniform with replacement."""
        pick = torch.from_numpy(rng.integers(len(self.train), size=size))
        return self.train[pick.to(self.train.device)]

    def check_rows(self) -> Tensor:
        """At most `VALIDATION_ROWS` held-out transitions, evenly spaced."""
        return self.val[:: max(1, len(self.val) // VALIDATION_ROWS)][:VALIDATION_ROWS]

    def held_out(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Held-out transitions to calibrate models on: all, or some 25,000 to 50,000 of them."""
        return self.transitions(self.val[:: max(1, -(-len(self.val) // CALIBRATION_ROWS))])


def fit_on_latents(
    kind: str,
    module: nn.Module,
    data: LatentData,
    loss: Callable[[np.random.Generator, int], tuple[Tensor, dict[str, Tensor]]],
    validate: Callable[[Tensor], dict[str, float]],
    *,
    config: FitConfig,
    setting: Setting,
) -> list[dict[str, float]]:
    """Run the training loop for one of the models on frozen latents.

    `loss` draws a batch of the size it is given; `validate` takes rows of held-out transitions.

    Args:
        kind: of the part; names its random stream and its progress bar.
        module: what to train, on its device.
        data: the dataset in latent space.
        loss: takes a generator and a batch size; returns the loss and its parts, scalars.
        validate: takes rows i64 of held-out transitions; returns metrics.
        config: steps, batch size, rate, intervals.
        setting: seed, folder, progress.

    Returns:
        Rows of metrics, see `fit.fit`.
    """
    check = data.check_rows()
    return fit(
        kind,
        module,
        lambda rng: loss(rng, config.batch_size),
        lambda: validate(check),
        config=config,
        setting=setting,
    )


def fit_scale(scale: LatentScale, data: LatentData) -> None:
    """Fit a model's scale to the transitions for training."""
    z, _, _, z_next = data.transitions(data.train)
    scale.fit(z, z_next)
