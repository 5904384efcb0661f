"""A whole dataset encoded by a trained φ."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.latents import LatentData
from elast_cli.models.outputs import Outputs
from elast_cli.models.part import Setting
from elast_cli.shapes import Float32, Int64


@torch.no_grad()
def encode(
    dataset: Dataset,
    context: Tensor,
    encoder: Encoder,
    setting: Setting,
    *,
    windows: FrameWindows | None = None,
    outputs: Outputs | None = None,
) -> LatentData:
    """Encode every row of a dataset with a trained φ.

    Args:
        dataset: what to encode.
        context: context vector of each episode [E,C].
        encoder: φ.
        setting: seed of the split, device, memory.
        windows: the dataset's windows, where they are there already.
        outputs: latents that were computed before.
    """
    device = setting.device
    z = _every_row(dataset, context, encoder, setting, windows=windows, outputs=outputs)
    train, val = dataset.split(setting.validation_share, setting.seed)
    return LatentData(
        z=z,
        action=torch.from_numpy(dataset.action).to(device),
        context=context.to(device)[torch.from_numpy(dataset.episode).to(device)],
        state=torch.from_numpy(dataset.state).to(device),
        train=torch.from_numpy(dataset.starts(train, 1)).to(device),
        val=torch.from_numpy(dataset.starts(val, 1)).to(device),
    )


def encode_goals(
    dataset: Dataset,
    context: Tensor,
    encoder: Encoder,
    setting: Setting,
    *,
    outputs: Outputs | None = None,
) -> Tensor:
    """Latents [N,Z] of every row's state at rest: its frame in all places, as tasks show goals.

    Args:
        dataset: what to encode.
        context: context vector of each episode [E,C].
        encoder: φ.
        setting: device, memory.
        outputs: latents that were computed before.
    """
    still = encoder.config.frames > 1  # else the frame is all that φ sees
    return _every_row(dataset, context, encoder, setting, outputs=outputs, still=still)


@torch.no_grad()
def _every_row(
    dataset: Dataset,
    context: Tensor,
    encoder: Encoder,
    setting: Setting,
    *,
    windows: FrameWindows | None = None,
    outputs: Outputs | None = None,
    still: bool = False,
) -> Tensor:
    """Latents [N,Z] of all states of a dataset, or of all as states at rest."""
    device = setting.device
    encoder.eval()

    def make() -> Float32:
        shown = windows or FrameWindows(
            dataset, frame_features(dataset, encoder, setting), context.to(device)
        )
        own = deepcopy(encoder)  # its weights in fresh memory: products may depend on alignment
        return latents(own, shown, np.arange(len(dataset.pixels)), still=still).cpu().numpy()

    shape = len(dataset.pixels), encoder.config.latent_size
    of = "goals" if still else None
    z = outputs.array(encoder, encoder.config, shape, make, of=of) if outputs else make()
    return torch.from_numpy(z).to(device)


@torch.no_grad()
def latents(encoder: Encoder, windows: FrameWindows, rows: Int64, *, still: bool = False) -> Tensor:
    """Latents [M,Z] of the states at `rows` [M]; where `still`, of these states at rest."""
    found = torch.empty(len(rows), encoder.config.latent_size, device=windows.context.device)
    done = 0  # filled in place: small results kept between large ones would scatter the heap
    for part in np.array_split(rows, max(1, len(rows) // 1024)):
        stacks = windows.stacks(part, np.full(len(part), still) if still else None)
        found[done : done + len(part)] = encoder(stacks)
        done += len(part)
    return found
