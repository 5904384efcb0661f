"""Training of the cloned policy on frozen latents (CPC-GCBC, Sec. 5.1)."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from elast_cli.models.goal_policy.cloning import Cloning, fit_clone
from elast_cli.models.goal_policy.data import GoalData
from elast_cli.models.goal_policy.gcbc.config import GcbcSection, GcbcSpec
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import fit_scale
from elast_cli.models.part import Setting, Trained, seed_torch
from elast_cli.shapes import Int64


def train(inputs: Inputs, section: GcbcSection, setting: Setting) -> Trained:
    """The policy, trained on latents.

    Args:
        inputs: the dataset and the parts that this one needs.
        section: configuration.
        setting: seed, device, folder.
    """
    return train_gcbc(GoalData.of(inputs), section, setting)


def train_gcbc(data: GoalData, section: GcbcSection, setting: Setting) -> Trained:
    """Train the policy on goals uniform over the future of the same episode.

    Args:
        data: the dataset in latent space, with hindsight goals.
        section: configuration.
        setting: seed, device, folder.
    """
    seed_torch(setting.seed, "gcbc")
    spec = GcbcSpec(sizes=data.latents.sizes, net=section.net)
    model = spec.build().to(setting.device)
    fit_scale(model.scale, data.latents)

    def predict(rows: Int64, goals: Int64, _rng: np.random.Generator) -> Tensor:
        found: Tensor = model(*data.towards(rows, goals))
        return found

    train, check = (Cloning(h, predict, data.latents.action) for h in (data.train, data.val))
    curve, metrics = fit_clone("gcbc", model, train, check, section.fit, setting)
    return Trained(model, spec, curve, metrics)
