"""Training of φ and h_f (Eq. 4), and measurement of the latents."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError
from elast_cli.models.encoder.config import EncoderSection, EncoderSpec
from elast_cli.models.encoder.cpc import Representation, cpc_loss
from elast_cli.models.encoder.encode import encode, latents
from elast_cli.models.encoder.hard_negatives import Lookalikes, Starts
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.fit import fit
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import VALIDATION_ROWS, LatentData
from elast_cli.models.part import Setting, Sizes, Trained, seed_torch, stream
from elast_cli.models.probe import probe_state
from elast_cli.seeding import generator


def train(inputs: Inputs, section: EncoderSection, setting: Setting) -> Trained:
    """φ and h_f, trained on frames."""
    return train_encoder(inputs.dataset, inputs.context, section, setting)


def train_encoder(
    dataset: Dataset, context: Tensor, section: EncoderSection, setting: Setting
) -> Trained:
    """Train φ and h_f on Eq. 4, then measure the latents: step lengths, probes of the true state.

    Args:
        dataset: random interaction data.
        context: context vector of each episode [E,C].
        section: configuration.
        setting: seed, device, folder.

    Raises:
        DataError: the episodes are too short for the horizon.
    """
    seed_torch(setting.seed, "encoder")
    action_size = dataset.action.shape[1]
    model = Representation(section.net, section.cpc, action_size, context.shape[1])
    model.to(setting.device)
    train, val = dataset.split(setting.validation_share, setting.seed)
    features = frame_features(dataset, model.encoder).to(setting.device)
    windows = FrameWindows(dataset, features, context.to(setting.device))
    horizon = section.cpc.horizon
    starts, held_out = dataset.starts(train, horizon), dataset.starts(val, horizon)
    if not (len(starts) and len(held_out)):
        raise DataError(
            f"no episode is longer than encoder.cpc.horizon, {horizon} steps; collect longer ones "
            "(--set collect.episode_steps=50)"
        )
    sample = generator("train", setting.seed, stream("encoder")).choice(starts, 4096)
    model.encoder.fit_normalization(windows.stacks(sample).flatten(0, 1))
    check = held_out[:: max(1, len(held_out) // VALIDATION_ROWS)][:VALIDATION_ROWS]
    batches: Starts | Lookalikes = Starts(starts)
    if section.cpc.lookalikes > 1:
        batches = Lookalikes(
            starts,
            lambda rows: latents(model, windows, rows + horizon).cpu().numpy(),
            group=section.cpc.lookalikes,
            refresh=section.cpc.refresh,
        )

    def loss(rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        rows = batches.batch(rng, section.fit.batch_size)
        still = rng.random((len(rows), horizon + 1)) < section.cpc.still_share
        return cpc_loss(model, *windows.window(rows, horizon, still), section.cpc)

    def validate() -> dict[str, float]:
        parts = [
            cpc_loss(model, *windows.window(rows, horizon), section.cpc)[1]
            for rows in np.array_split(check, max(1, len(check) // section.fit.batch_size))
        ]
        return {k: float(torch.stack([p[k] for p in parts]).mean()) for k in parts[0]}

    curve = fit("encoder", model, loss, validate, config=section.fit, setting=setting)
    data = encode(dataset, context, model, setting)
    z, z_next = data.z[data.train], data.z[data.train + 1]
    model.scale.fit(z, z_next)
    model.step_length_quantiles.fit((z_next - z).norm(dim=1))
    sizes = Sizes(
        latent=section.net.latent_size,
        action=action_size,
        context=context.shape[1],
        state=dataset.state.shape[1],
    )
    spec = EncoderSpec(sizes=sizes, net=section.net, cpc=section.cpc)
    return Trained(model, spec, curve, _encoder_metrics(model, data, dataset, curve))


def _encoder_metrics(
    model: Representation, data: LatentData, dataset: Dataset, curve: list[dict[str, float]]
) -> dict[str, float]:
    z, action, context, z_next = data.transitions(data.val)
    with torch.no_grad():
        error = (model.dynamics(z, action, context) - z_next).norm(dim=1)
    probes = probe_state(
        data.z.cpu().numpy(), dataset.state, data.train.cpu().numpy(), data.val.cpu().numpy()
    )
    used = torch.linalg.svdvals(z - z.mean(0)).square()
    return {
        "val_info_nce": curve[-1]["val_info_nce"],
        "val_one_step_error_in_steps": float(error.mean()) / model.step_length(0.5),
        "latent_dimensions_used": float(used.sum().square() / used.square().sum()),
        **probes,
    }
