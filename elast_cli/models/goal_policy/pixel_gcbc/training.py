"""Training of the cloned policy on images (V-GCBC, Sec. 5.1)."""

from __future__ import annotations

import numpy as np
from torch import Tensor, from_numpy

from elast_cli.models.encoder.training import NORMALIZED
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.goal_policy.cloning import Cloning, fit_clone
from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.models.goal_policy.pixel_gcbc.config import PixelGcbcSection, PixelGcbcSpec
from elast_cli.models.goal_policy.pixel_gcbc.shift import random_offsets, shifted
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.seeding import generator
from elast_cli.shapes import Int64

KIND = "pixel_gcbc"


def train(inputs: Inputs, section: PixelGcbcSection, setting: Setting) -> Trained:
    """The policy, trained on images and hindsight goals; arguments as in `gcbc.training.train`."""
    seed_torch(setting.seed, KIND)
    dataset, context = inputs.dataset, inputs.context.to(setting.device)
    sizes = {"action": dataset.action.shape[1], "context": context.shape[1]}
    spec = PixelGcbcSpec(net=section.net, **sizes)
    model = spec.build().to(setting.device)
    windows = FrameWindows(dataset, frame_features(dataset, model, setting), context)
    starts = [
        dataset.starts(part, 1) for part in dataset.split(setting.validation_share, setting.seed)
    ]
    sample = generator("train", setting.seed, stream(KIND)).choice(starts[0], NORMALIZED)
    model.fit_normalization(windows.features.take(sample))

    def images(rows: Int64, goals: Int64) -> Tensor:
        return model.beside(windows.stacks(rows), windows.features.take(goals))

    def predict(rows: Int64, goals: Int64, _rng: np.random.Generator) -> Tensor:
        return model.act(images(rows, goals), windows.contexts(rows))

    def predict_shifted(rows: Int64, goals: Int64, rng: np.random.Generator) -> Tensor:
        moved = shifted(images(rows, goals), random_offsets(rng, len(rows), section.shift))
        return model.act(moved, windows.contexts(rows))

    action = from_numpy(dataset.action).to(setting.device)
    train, check = (Hindsight.of(dataset, rows) for rows in starts)
    curve, metrics = fit_clone(
        KIND,
        model,
        Cloning(train, predict_shifted, action),
        Cloning(check, predict, action),
        section.fit,
        setting,
    )
    return Trained(model, spec, curve, metrics)
