"""Training of the recurrent state-space model, on sequences of frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from elast_cli.models.fit import fit
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import VALIDATION_ROWS
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.models.probe import thinned
from elast_cli.models.rssm.config import RssmSection, RssmSpec
from elast_cli.models.rssm.elbo import elbo_loss
from elast_cli.models.rssm.measures import measured
from elast_cli.models.rssm.net import Rssm
from elast_cli.models.rssm.sequences import SequenceData, sequence_starts
from elast_cli.seeding import generator
from elast_cli.shapes import Int64

KIND = "rssm"
TOGETHER = 16  # sequences that are validated at once


def train(inputs: Inputs, section: RssmSection, setting: Setting) -> Trained:
    """The model, trained on sequences of episodes and measured on others.

    Args:
        inputs: the dataset.
        section: configuration.
        setting: seed, device, folder, memory.
    """
    seed_torch(setting.seed, KIND)
    dataset = inputs.dataset
    spec = RssmSpec(net=section.net, action=dataset.action.shape[1])
    model = spec.build().to(setting.device)
    split = dataset.split(setting.validation_share, setting.seed)
    starts, held_out = (sequence_starts(dataset, part, section.elbo.length) for part in split)
    data = SequenceData(dataset, setting)
    objective = Objective(
        model,
        data,
        starts,
        thinned(held_out, max(1, VALIDATION_ROWS // section.elbo.length)),
        section,
    )
    curve = fit(
        KIND, model, objective.loss, objective.validate, config=section.fit, setting=setting
    )
    metrics, shown = measured(model, data, dataset, split, section.elbo.length)
    last = {name: value for name, value in curve[-1].items() if name.startswith("val_")}
    return Trained(model, spec, curve, last | metrics, shown)


@dataclass(frozen=True)
class Objective:
    """The objective on sequences of a dataset.

    Attributes:
        model: that is trained.
        data: frames and actions.
        starts: first rows of sequences for training.
        check: of those that are held out.
        section: configuration.
    """

    model: Rssm
    data: SequenceData
    starts: Int64
    check: Int64
    section: RssmSection

    def loss(self, rng: np.random.Generator) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Loss of a batch and its parts."""
        first = self.starts[rng.integers(len(self.starts), size=self.section.fit.batch_size)]
        return self._loss(first, rng)

    def validate(self) -> dict[str, float]:
        """The loss of held-out sequences and its parts, with the same noise each time."""
        rng = generator("train", 0, stream(KIND))
        groups = np.array_split(self.check, -(-len(self.check) // TOGETHER))
        found = [self._loss(first, rng) for first in groups]
        rows = [
            {"loss": float(loss), **{k: float(v) for k, v in parts.items()}}
            for loss, parts in found
        ]
        weights = [len(first) for first in groups]
        return {k: float(np.average([row[k] for row in rows], weights=weights)) for k in rows[0]}

    def _loss(self, first: Int64, rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        elbo, device = self.section.elbo, self.model.enter.weight.device
        draws = torch.Generator(device).manual_seed(int(rng.integers(1 << 62)))
        batch = self.data.take(first, elbo.length, draws)
        shape = (*batch.known.shape, self.model.config.stochastic)
        noise = torch.randn(shape, generator=draws, device=device)
        return elbo_loss(self.model, batch, noise, elbo)
