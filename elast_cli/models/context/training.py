"""How the context autoencoder is trained and measured; all else is in `training`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from elast_cli.config import StrictModel
from elast_cli.models.context.net import (
    ContextAutoencoder,
    ContextConfig,
    context_vectors,
    reconstruction_error,
)
from elast_cli.models.fit import FitConfig, fit
from elast_cli.models.part import STAGES, Setting, Trained, seed_torch
from elast_cli.models.probe import probe_state
from elast_cli.shapes import Int64, Uint8

THUMBNAIL = 8  # side of the images that context vectors are probed for


class ContextStage(StrictModel):
    """Everything `train-context` needs."""

    net: ContextConfig = ContextConfig()
    fit: FitConfig = FitConfig(steps=2000, batch_size=128)


def train_context(
    images: Uint8, split: tuple[Int64, Int64], stage: ContextStage, setting: Setting
) -> Trained:
    """Train the autoencoder of context images, then measure it on images it has not seen.

    Args:
        images: one raw image an episode, u8 [E,64,64,3].
        split: episodes for training and for validation.
        stage: configuration.
        setting: seed, device, folder.
    """
    seed_torch(setting.seed, "context")
    model = ContextAutoencoder(stage.net).to(setting.device)
    train, val = split
    features = model.preprocess(torch.from_numpy(images).to(setting.device))
    model.fit_normalization(features[train])
    held_out = features[val]

    def loss(rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        rows = train[rng.integers(len(train), size=stage.fit.batch_size)]
        error = reconstruction_error(model, features[rows])
        return error, {"mse": error}

    curve = fit(
        model,
        loss,
        config=stage.fit,
        seed=setting.seed,
        stage=STAGES["context"],
        label="context",
        work=setting.work,
        validate=lambda: {"mse": float(reconstruction_error(model, held_out))},
        progress=setting.progress,
    )
    with torch.no_grad():
        model.fit_codes(model.code(features[train]))
        variance = float((held_out.float() - held_out.float().mean(0)).square().mean())
        error = float(reconstruction_error(model, held_out) * model.scale.square())
    thumbnails = functional.avg_pool2d(features.float(), model.side // THUMBNAIL).flatten(1)
    probes = probe_state(context_vectors(model, images), thumbnails.cpu().numpy(), train, val)
    metrics = {
        "val_reconstruction_r2": 1 - error / max(variance, 1e-12),
        "val_reconstruction_rmse": error**0.5,  # in grey levels of 0 to 255
        **probes,
    }
    return Trained(model, None, curve, metrics)
