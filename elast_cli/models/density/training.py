"""Training of ψ: what is contrasted with what, and where its threshold lies (Sec. 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from elast_cli.models.density.config import DensitySection, DensitySpec
from elast_cli.models.density.net import TransitionDensity, nce_loss
from elast_cli.models.density.noise import Noise, OtherContexts
from elast_cli.models.ensemble.net import DynamicsEnsemble
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import LatentData, fit_on_latents, fit_scale
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.seeding import generator

FARTHER = 0.1  # of a median step: how much farther a false step must get in another context
ALIKE = 0.25  # of a median step: how near two ends count as the same; H_f errs by half of it


def train(inputs: Inputs, section: DensitySection, setting: Setting) -> Trained:
    """ψ, trained on latents; where there are contexts, with the ensemble's help.

    Args:
        inputs: the dataset, the encoder; where there are contexts, autoencoder and ensemble.
        section: configuration.
        setting: seed, device, folder.
    """
    ensemble = None
    if inputs.has("ensemble"):
        ensemble = inputs.part("ensemble", SupportedDynamics).ensemble
    return train_density(inputs.latents, section, setting, ensemble)


@dataclass(frozen=True)
class Contrast:
    """The objective of ψ (Eq. 2): what is contrasted with what.

    Attributes:
        psi: the density.
        data: the dataset in latent space.
        noise: false successors.
        others: false transitions of other contexts, where there are contexts.
    """

    psi: TransitionDensity
    data: LatentData
    noise: Noise
    others: OtherContexts | None

    def __call__(
        self, rows: Tensor, rng: np.random.Generator, relabelled_share: float = 0.0
    ) -> tuple[Tensor, Tensor]:
        """NCE loss and balanced accuracy of the transitions at `rows` [M]: scalars.

        Up to `relabelled_share` of them are replaced by transitions of other episodes that fit.
        """
        data, others, ratio = self.data, self.others, self.psi.config.noise_ratio
        places = others.relabelled(rows, relabelled_share, rng) if others else rows
        z, _, _, z_next = data.transitions(places)
        count, false = self.noise.ratio, self.noise.draw(places, rng).flatten(0, 1)
        sources, targets = z.repeat(1 + count, 1), torch.cat([z_next, false])
        if others:
            elsewhere, there = others.draw(places, rows, rng)
            sources = torch.cat([sources, elsewhere.flatten(0, 1)])
            targets = torch.cat([targets, there.flatten(0, 1)])
        contexts = data.context[rows].repeat(1 + ratio, 1)
        is_data = torch.arange(len(sources), device=z.device) < len(z)
        log_ratio = self.psi.log_ratio(sources, targets, contexts)
        zero = torch.zeros_like(log_ratio)
        correct = ((log_ratio > 0) == is_data).float()
        accuracy = 0.5 * (correct[: len(z)].mean() + correct[len(z) :].mean())
        return nce_loss(log_ratio, zero, is_data, ratio), accuracy


def train_density(
    data: LatentData,
    section: DensitySection,
    setting: Setting,
    ensemble: DynamicsEnsemble | None = None,
) -> Trained:
    """Train ψ by NCE (Eq. 2), then calibrate its threshold on held-out transitions.

    Where there are contexts, `ensemble` says where steps lead in others.

    Args:
        data: the dataset in latent space.
        section: configuration.
        setting: seed, device, folder.
        ensemble: H_f; needed where noise comes from other contexts.

    Raises:
        ValueError: noise from other contexts is asked for without the ensemble.
    """
    seed_torch(setting.seed, "density")
    psi = TransitionDensity(section.net, data.z.shape[1], data.context.shape[1]).to(setting.device)
    fit_scale(psi.scale, data)
    contrast = Contrast(psi, data, _noise(data, psi, setting), _other_contexts(data, psi, ensemble))

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        value, accuracy = contrast(data.batch(rng, size), rng, section.net.relabelled_share)
        return value, {"balanced_accuracy": accuracy}

    def validate(rows: Tensor) -> dict[str, float]:
        value, accuracy = contrast(rows, generator("train", 0, stream("density")))
        return {"nce": float(value), "balanced_accuracy": float(accuracy)}

    curve = fit_on_latents(
        "density", psi, data, loss, validate, config=section.fit, setting=setting
    )
    with torch.no_grad():
        z, _, context, z_next = data.held_out()
        psi.log_density_quantiles.fit(psi(z, z_next, context))
    metrics = {f"val_{name}": curve[-1][f"val_{name}"] for name in ("nce", "balanced_accuracy")}
    return Trained(psi, DensitySpec(sizes=data.sizes, net=section.net), curve, metrics)


def _step_length(data: LatentData, share: float) -> float:
    """The quantile of the lengths of observed steps, in latent units."""
    z, _, _, z_next = data.transitions(data.train)
    return float(np.quantile((z_next - z).norm(dim=1).cpu().numpy(), share))


def _other_contexts(
    data: LatentData, psi: TransitionDensity, ensemble: DynamicsEnsemble | None
) -> OtherContexts | None:
    """Noise from other contexts, where there are any and some is asked for."""
    count = psi.config.elsewhere(data.context.shape[1])
    if not count:
        return None
    if ensemble is None:
        raise ValueError("noise from other contexts needs the ensemble")

    step = _step_length(data, 0.5)
    return OtherContexts(
        data.z,
        data.action,
        data.context,
        data.train,
        ensemble.by_one_member,
        margin=FARTHER * step,
        alike=ALIKE * step,
        count=count,
    )


def _noise(data: LatentData, psi: TransitionDensity, setting: Setting) -> Noise:
    contexts = data.context.shape[1]
    return Noise(
        data.z,
        data.train,
        std=psi.noise_std(),
        ratio=psi.config.noise_ratio - psi.config.elsewhere(contexts),
        near=psi.config.near(contexts),
        radius=psi.config.near_radius * _step_length(data, 0.95),
        rng=generator("train", setting.seed, stream("density")),
    )
