"""Contrastive predictive coding: what trains φ together with h_f (Eq. 3, 4)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional

from elast_cli.models.encoder.config import CpcConfig, EncoderConfig
from elast_cli.models.encoder.isometry import isometry_loss
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.nets import ForwardModel, LatentScale, QuantileTable, mlp


def info_nce(prediction: Tensor, future: Tensor) -> Tensor:
    """InfoNCE with the critic -‖z̃ - z‖² (Eq. 3, 4): scalar from predictions [M,Z], states [nM,Z].

    Row i's positive is state i; all others are its negatives.
    """
    logits = -torch.cdist(prediction, future).square()
    return functional.cross_entropy(logits, torch.arange(len(logits), device=logits.device))


class Representation(nn.Module):
    """φ and h_f, trained together, with the statistics of the latents they produce."""

    def __init__(
        self, encoder: EncoderConfig, cpc: CpcConfig, action_size: int, context_size: int
    ) -> None:
        super().__init__()
        self.cpc = cpc
        self.encoder = Encoder(encoder)
        self.dynamics = ForwardModel(
            encoder.latent_size, action_size, context_size, cpc.dynamics_width
        )
        width = cpc.dynamics_width
        if cpc.inverse_weight:
            n_in = 2 * encoder.latent_size + context_size
            self.inverse = mlp([n_in, width, width, action_size])
        self.scale = LatentScale(encoder.latent_size)
        self.step_length_quantiles = QuantileTable()

    def step_length(self, probability: float) -> float:
        """Length in latent units below which a share `probability` of observed steps lies."""
        return self.step_length_quantiles.at(probability)


def cpc_loss(
    model: Representation, features: Tensor, actions: Tensor, context: Tensor, config: CpcConfig
) -> tuple[Tensor, dict[str, Tensor]]:
    """Loss of Eq. 4 and its parts.

    Args:
        model: φ and h_f.
        features: preprocessed stacks [M, k+1, F, 3, S, S].
        actions: [M, k, A].
        context: [M, C].
        config: k and K_h.
    """
    m, steps = features.shape[0], features.shape[1]
    flat = features.flatten(0, 1)
    z = model.encoder(flat).unflatten(0, (m, steps))
    predicted, consistency = rollout(model.dynamics, z, actions, context)
    latest_first = z.flip(1).transpose(0, 1).flatten(0, 1)
    states = latest_first if config.negatives == "window" else z[:, -1]
    contrast = info_nce(predicted, states)
    total = contrast + config.consistency_weight * consistency
    parts = {"info_nce": contrast, "consistency": consistency}
    if config.isometry_weight:
        images = model.encoder.normalized(flat[:, -1]).unflatten(0, (m, steps))
        isometry = isometry_loss(z, images, blur=config.isometry_blur, reach=config.isometry_reach)
        total, parts = total + config.isometry_weight * isometry, {**parts, "isometry": isometry}
    if config.inverse_weight:
        inverse = inverse_loss(model.inverse, z, actions, context)
        total, parts = total + config.inverse_weight * inverse, {**parts, "inverse": inverse}
    return total, parts


def rollout(
    dynamics: ForwardModel, z: Tensor, actions: Tensor, context: Tensor
) -> tuple[Tensor, Tensor]:
    """h_f's prediction of the last state [M,Z], and the consistency term of Eq. 4: scalar.

    Args:
        dynamics: h_f.
        z: latents of windows [M,k+1,Z]; it starts from the first.
        actions: between them [M,k,A].
        context: [M,C].
    """
    predicted, consistency = z[:, 0], torch.zeros((), device=z.device)
    for i in range(actions.shape[1]):
        predicted = dynamics(predicted, actions[:, i], context)
        consistency = consistency + (z[:, i + 1] - predicted).square().sum(-1).mean()
    return predicted, consistency


def inverse_loss(
    network: Callable[[Tensor], Tensor], z: Tensor, actions: Tensor, context: Tensor
) -> Tensor:
    """Mean squared error of actions read off the states before and after them: scalar.

    Args:
        network: takes a state, the step from it and the context, [N,2Z+C] -> [N,A].
        z: latents of windows [M,k+1,Z].
        actions: between them [M,k,A].
        context: [M,C].
    """
    given = context[:, None].expand(-1, actions.shape[1], -1)
    read = network(torch.cat([z[:, :-1], z[:, 1:] - z[:, :-1], given], dim=2))
    return functional.mse_loss(read, actions)
