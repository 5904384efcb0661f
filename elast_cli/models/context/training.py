"""Training of the context autoencoder, and its measures on images it has not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from elast_cli.data.images import Images, blocks
from elast_cli.errors import DataError
from elast_cli.models.context.config import ContextSection, ContextSpec
from elast_cli.models.context.net import (
    ContextAutoencoder,
    context_vectors,
    reconstruction_error,
    reconstructions,
)
from elast_cli.models.fit import fit
from elast_cli.models.frames import image_features
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import VALIDATION_ROWS
from elast_cli.models.part import Reconstructions, Setting, Trained, seed_torch
from elast_cli.models.probe import probe_state, thinned
from elast_cli.shapes import Float32, Int64

SHOWN = 10  # reconstructions
STATISTICS = 20_000  # images whose statistics are taken
THUMBNAIL = 8  # side of the images that context vectors are probed for


def train(inputs: Inputs, section: ContextSection, setting: Setting) -> Trained:
    """The autoencoder, trained on one context image an episode.

    Raises:
        DataError: the dataset has no context images.
    """
    images = inputs.dataset.context
    if images is None:
        raise DataError("the dataset has no context images; collect it again with --force")
    split = inputs.dataset.split(setting.validation_share, setting.seed)
    trained = train_context(images, split, section, setting)
    assert isinstance(trained.module, ContextAutoencoder)
    shown = split[1][:SHOWN]
    decoded = {"reconstructed": reconstructions(trained.module, images[shown])}
    labels = [f"episode {episode}" for episode in shown]
    return replace(trained, reconstructions=Reconstructions(images[shown], decoded, labels))


def train_context(
    images: Images, split: tuple[Int64, Int64], section: ContextSection, setting: Setting
) -> Trained:
    """Train the autoencoder of context images, then measure it on images it has not seen.

    Args:
        images: one raw image an episode, u8 [E,64,64,3].
        split: episodes for training and for validation.
        section: configuration.
        setting: seed, device, folder.
    """
    seed_torch(setting.seed, "context")
    model = ContextAutoencoder(section.net).to(setting.device)
    train, val = split
    features = image_features(images, model, setting)
    some = thinned(train, STATISTICS)
    model.fit_normalization(features.take(some))
    held_out = features.take(thinned(val, VALIDATION_ROWS))

    def loss(rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        rows = train[rng.integers(len(train), size=section.fit.batch_size)]
        error = reconstruction_error(model, features.take(rows))
        return error, {"mse": error}

    def validate() -> dict[str, float]:
        return {"mse": float(reconstruction_error(model, held_out))}

    curve = fit("context", model, loss, validate, config=section.fit, setting=setting)
    with torch.no_grad():
        model.fit_codes(model.code(features.take(some)))
    metrics = _metrics(model, images, held_out, split)
    return Trained(model, ContextSpec(net=section.net), curve, metrics)


@torch.no_grad()
def _metrics(
    model: ContextAutoencoder, images: Images, held_out: Tensor, split: tuple[Int64, Int64]
) -> dict[str, float]:
    """How well held-out images are reconstructed, and what context vectors hold of them."""
    variance = float((held_out.float() - held_out.float().mean(0)).square().mean())
    error = float(reconstruction_error(model, held_out) * model.scale.square())
    probes = probe_state(context_vectors(model, images), _thumbnails(model, images), *split)
    return {
        "val_reconstruction_r2": 1 - error / max(variance, 1e-12),
        "val_reconstruction_rmse": error**0.5,  # in grey levels of 0 to 255
        **probes,
    }


def _thumbnails(model: ContextAutoencoder, images: Images) -> Float32:
    """Images u8 [N,64,64,3] at the size that context vectors are probed for: [N,3·8·8]."""
    parts = [
        functional.avg_pool2d(
            model.preprocess(torch.from_numpy(block)).float(), model.side // THUMBNAIL
        ).flatten(1)
        for _, block in blocks(images)
    ]
    return torch.cat(parts).numpy()
