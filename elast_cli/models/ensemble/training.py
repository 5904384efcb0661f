"""Training of the dynamics ensemble H_f, and its calibration."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.models.ensemble.config import EnsembleSection, EnsembleSpec
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import LatentData, fit_on_latents, fit_scale
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.seeding import generator


def train(inputs: Inputs, section: EnsembleSection, setting: Setting) -> Trained:
    """H_f and its support, trained on latents.

    Args:
        inputs: the dataset, the encoder and, where there are contexts, the autoencoder.
        section: configuration.
        setting: seed, device, folder.
    """
    return train_ensemble(inputs.latents, section, setting)


def train_ensemble(data: LatentData, section: EnsembleSection, setting: Setting) -> Trained:
    """Train H_f's members, each on its own batches, then calibrate variance and support.

    Args:
        data: the dataset in latent space.
        section: configuration.
        setting: seed, device, folder.
    """
    seed_torch(setting.seed, "ensemble")
    size = min(section.net.support_size, len(data.train))
    config, sizes = section.net.model_copy(update={"support_size": size}), data.sizes
    dynamics = SupportedDynamics(
        config,
        latent_size=sizes.latent,
        action_size=sizes.action,
        context_size=sizes.context,
        state_size=sizes.state,
    ).to(setting.device)
    model = dynamics.ensemble
    fit_scale(model.scale, data)
    members = section.net.members

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        rows = data.batch(rng, members * size)
        parts = data.transitions(rows)
        z, action, context, z_next = (part.unflatten(0, (members, size)) for part in parts)
        target = (z_next - z) / model.scale.step
        error = (model.members(z, action, context) - target).square().mean()
        return members * error, {"mse": error}

    def validate(rows: Tensor) -> dict[str, float]:
        z, action, context, z_next = data.transitions(rows)
        predicted, _ = model(z, action, context)
        return {"mse": float(((predicted - z_next) / model.scale.step).square().mean())}

    curve = fit_on_latents(
        "ensemble", model, data, loss, validate, config=section.fit, setting=setting
    )
    metrics = {"val_mse": curve[-1]["val_mse"], **_calibrate_dynamics(dynamics, data, setting)}
    return Trained(dynamics, EnsembleSpec(sizes=sizes, net=config), curve, metrics)


@torch.no_grad()
def _calibrate_dynamics(
    dynamics: SupportedDynamics, data: LatentData, setting: Setting
) -> dict[str, float]:
    """Fill the support and both quantile tables; returns held-out errors in median steps."""
    support = dynamics.support
    rng = generator("train", setting.seed, stream("ensemble"))
    pick = rng.choice(len(data.train), len(support.rows), replace=False)
    rows = data.train[torch.from_numpy(np.sort(pick)).to(data.train.device)]
    support.rows.copy_(rows)
    support.latents.copy_(data.z[rows])
    support.states.copy_(data.state[rows])
    z, action, context, z_next = data.held_out()
    predicted, variance = dynamics.ensemble(z, action, context)
    distance = support.distance(predicted)
    dynamics.ensemble.variance_quantiles.fit(variance)
    support.distance_quantiles.fit(distance)
    step = float((z_next - z).norm(dim=1).median())
    return {
        "val_one_step_error_in_steps": float((predicted - z_next).norm(dim=1).mean()) / step,
        "val_support_distance_p99_in_steps": support.distance_quantiles.at(0.99) / step,
    }
