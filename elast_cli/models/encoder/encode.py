"""A whole dataset encoded by a trained φ."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.latents import LatentData
from elast_cli.models.part import Setting
from elast_cli.shapes import Int64


@torch.no_grad()
def encode(
    dataset: Dataset, context: Tensor, model: Representation, setting: Setting
) -> LatentData:
    """Encode every row of a dataset with a trained φ."""
    device = setting.device
    model.eval()
    features = frame_features(dataset, model.encoder).to(device)
    windows = FrameWindows(dataset, features, context.to(device))
    rows = np.arange(len(dataset.pixels))
    train, val = dataset.split(setting.validation_share, setting.seed)
    return LatentData(
        z=latents(model, windows, rows),
        action=windows.actions,
        context=windows.contexts(rows),
        state=torch.from_numpy(dataset.state).to(device),
        train=torch.from_numpy(dataset.starts(train, 1)).to(device),
        val=torch.from_numpy(dataset.starts(val, 1)).to(device),
    )


@torch.no_grad()
def latents(model: Representation, windows: FrameWindows, rows: Int64) -> Tensor:
    """Latents [M,Z] of the states at `rows` [M]."""
    parts = [
        model.encoder(windows.stacks(part))
        for part in np.array_split(rows, max(1, len(rows) // 1024))
    ]
    return torch.cat(parts)
