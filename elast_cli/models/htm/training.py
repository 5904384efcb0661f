"""Training of the connectivity and the inverse model of HTM, on a trained autoencoder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from elast_cli.errors import DataError
from elast_cli.models.cvae.images import ImagePairs
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.cvae.training import evaluating
from elast_cli.models.fit import fit
from elast_cli.models.htm.config import HtmSection, HtmSpec
from elast_cli.models.htm.net import Htm, contrast
from elast_cli.models.htm.pairs import Pairs, PairSource
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.seeding import generator
from elast_cli.shapes import Int64

KIND = "htm"
CHECKED = 4  # held-out batches that are measured at every logged step
MEASURED = 16  # and at the end


def train(inputs: Inputs, section: HtmSection, setting: Setting) -> Trained:
    """Both networks, trained together. Arguments as in `cvae.training.train`.

    Raises:
        DataError: no episode is as long as the pairs are apart.
    """
    seed_torch(setting.seed, KIND)
    dataset, cvae = inputs.dataset, inputs.part("cvae", Cvae)
    action, contexts = dataset.action.shape[1], cvae.has_context
    spec = HtmSpec(net=section.net, cvae=cvae.config, has_context=contexts, action=action)
    model = spec.build().to(setting.device)
    model.begin_as(cvae.encoder)
    source = PairSource(dataset, ImagePairs.of(dataset, cvae, setting), cvae, section.pairs)
    episodes = dataset.split(setting.validation_share, setting.seed)
    starts, held_out = (dataset.starts(part, section.pairs.ahead) for part in episodes)
    if not (len(starts) and len(held_out)):
        raise DataError(
            f"no episode is longer than htm.pairs.ahead, {section.pairs.ahead} steps; lower it "
            "(--set htm.pairs.ahead=1) or collect longer ones (--set collect.episode_steps=50)"
        )
    objective, size = Objective(model, source, section), section.fit.batch_size

    def unseen(count: int) -> Iterator[Pairs]:
        rng = generator("train", setting.seed, stream(KIND))  # the same batches every time
        return (source.batch(held_out, rng, size) for _ in range(count))

    def loss(rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        parts = objective.parts(source.batch(starts, rng, size))
        return parts["info_nce"] + parts["inverse_mse"], parts

    def validate() -> dict[str, float]:
        return objective.measure(unseen(CHECKED))

    curve = fit(KIND, model, loss, validate, config=section.fit, setting=setting)
    found = objective.measure(unseen(MEASURED))
    metrics = {f"val_{name}": value for name, value in found.items()}
    metrics["val_action_r2"] = 1 - metrics["val_inverse_mse"] / _variance(inputs, held_out)
    return Trained(model, spec, curve, metrics)


@dataclass(frozen=True)
class Objective:
    """The losses of both networks on pairs of images."""

    model: Htm
    source: PairSource
    section: HtmSection

    def parts(self, batch: Pairs) -> dict[str, Tensor]:
        """InfoNCE of the score, and the mean squared error of the inverse model's actions."""
        positive, negative = self.scores(batch)
        images, context = batch.images
        if self.section.pairs.inverse_on == "reconstructions":
            images = batch.shown[: len(images)]
        before, after = self.model.inverse.encoder(images, context).chunk(2)
        actions = self.model.inverse(before, after)
        return {
            "info_nce": contrast(positive, negative),
            "inverse_mse": functional.mse_loss(actions, batch.action),
        }

    def scores(self, batch: Pairs) -> tuple[Tensor, Tensor]:
        """Scores of positive pairs [G,M], and of first images with negatives [G,M,N]."""
        score = self.model.score
        embedded = score.encoder(batch.shown, batch.shown_context)
        count = len(batch.action)
        before, after, made = (
            part.unflatten(0, (batch.groups, -1))
            for part in embedded.split([count, count, len(embedded) - 2 * count])
        )
        return score.of_pairs(before, after), score(before, made)

    def measure(self, batches: Iterable[Pairs]) -> dict[str, float]:
        """Mean losses, and the share of pairs that score above all their negatives."""
        found: list[Tensor] = []
        with evaluating(self.model):
            for batch in batches:
                positive, negative = self.scores(batch)
                best = (positive > negative.amax(-1)).float().mean()
                found.append(torch.stack([*self.parts(batch).values(), best]))
        names = ("info_nce", "inverse_mse", "accuracy")
        return dict(zip(names, torch.stack(found).mean(0).tolist(), strict=True))


def _variance(inputs: Inputs, rows: Int64) -> float:
    """Mean over dimensions of the variance of actions: the error of the best constant action."""
    return max(float(inputs.dataset.action[rows].var(0).mean()), 1e-12)
