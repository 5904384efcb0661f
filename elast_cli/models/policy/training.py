"""Training of the local policy π, and the calibration of its round trip."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.models.ensemble.net import DynamicsEnsemble
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import LatentData, fit_on_latents, fit_scale
from elast_cli.models.part import Setting, Trained, seed_torch
from elast_cli.models.policy.config import PolicySection, PolicySpec
from elast_cli.models.policy.net import LocalPolicy


def train(inputs: Inputs, section: PolicySection, setting: Setting) -> Trained:
    """π, trained on latents and calibrated by the ensemble.

    Args:
        inputs: the dataset, the encoder, the ensemble and, where there are contexts, the
            autoencoder.
        section: configuration.
        setting: seed, device, folder.
    """
    ensemble = inputs.part("ensemble", SupportedDynamics).ensemble
    return train_policy(inputs.latents, ensemble, section, setting)


def train_policy(
    data: LatentData, ensemble: DynamicsEnsemble, section: PolicySection, setting: Setting
) -> Trained:
    """Train π, then calibrate its round trip through H_f; arguments as in `train_density`."""
    seed_torch(setting.seed, "policy")
    sizes = data.z.shape[1], data.action.shape[1], data.context.shape[1]
    model = LocalPolicy(section.net, *sizes).to(setting.device)
    fit_scale(model.scale, data)

    def error(rows: Tensor) -> Tensor:
        z, action, context, z_next = data.transitions(rows)
        value: Tensor = (model(z, z_next, context) - action).square().mean()
        return value

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        value = error(data.batch(rng, size))
        return value, {"mse": value}

    curve = fit_on_latents(
        "policy",
        model,
        data,
        loss,
        lambda rows: {"mse": float(error(rows))},
        config=section.fit,
        setting=setting,
    )
    with torch.no_grad():
        z, _, context, z_next = data.held_out()
        back, _ = ensemble(z, model(z, z_next, context), context)
        miss = (back - z_next).norm(dim=1)
    model.round_trip_quantiles.fit(miss)
    length = float((z_next - z).norm(dim=1).median())
    metrics = {
        "val_mse": curve[-1]["val_mse"],
        "val_round_trip_in_steps": float(miss.mean()) / length,
    }
    return Trained(model, PolicySpec(sizes=data.sizes, net=section.net), curve, metrics)
