"""Training of inverse dynamics over h steps: (z_t, z_{t+h}, h) -> a_t."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.models.goal_policy.cloning import Cloning, fit_clone
from elast_cli.models.goal_policy.data import GoalData
from elast_cli.models.goal_policy.gcidm.config import GcidmSection, GcidmSpec
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import fit_scale
from elast_cli.models.part import Setting, Trained, seed_torch
from elast_cli.shapes import Int64


def train(inputs: Inputs, section: GcidmSection, setting: Setting) -> Trained:
    """The model, trained on latents.

    Args:
        inputs: the dataset and the parts that this one needs.
        section: configuration.
        setting: seed, device, folder.
    """
    return train_gcidm(GoalData.of(inputs), section, setting)


def train_gcidm(data: GoalData, section: GcidmSection, setting: Setting) -> Trained:
    """Train the model with goals uniform over the next `net.longest` states of the episode.

    The network is given 1/h. At a constant speed, a goal h steps ahead takes steps of (z_g - z)/h,
    and so 1/h is what the action depends on.

    Args:
        data: the dataset in latent space, with hindsight goals.
        section: configuration.
        setting: seed, device, folder.
    """
    seed_torch(setting.seed, "gcidm")
    spec = GcidmSpec(sizes=data.latents.sizes, net=section.net)
    model = spec.build().to(setting.device)
    fit_scale(model.scale, data.latents)

    def predict(rows: Int64, goals: Int64, _rng: np.random.Generator) -> Tensor:
        z, goal, context = data.towards(rows, goals)
        pace = 1 / data.index(goals - rows).float()
        found: Tensor = model(z, goal, torch.cat([pace[:, None], context], dim=1))
        return found

    train, check = (
        Cloning(h, predict, data.latents.action, section.net.longest)
        for h in (data.train, data.val)
    )
    curve, metrics = fit_clone("gcidm", model, train, check, section.fit, setting)
    return Trained(model, spec, curve, metrics)
