"""Training of φ and h_f (Eq. 4, or a β-VAE), and measurement of the latents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError
from elast_cli.models.encoder.config import EncoderSection, EncoderSpec
from elast_cli.models.encoder.cpc import Representation, cpc_loss
from elast_cli.models.encoder.encode import encode, latents
from elast_cli.models.encoder.hard_negatives import HardNegatives, Starts
from elast_cli.models.encoder.vae import BetaVae, vae_loss
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.fit import fit
from elast_cli.models.inputs import Inputs
from elast_cli.models.latents import VALIDATION_ROWS, LatentData
from elast_cli.models.outputs import Outputs
from elast_cli.models.part import Setting, Trained, seed_torch, stream
from elast_cli.models.probe import probe_state
from elast_cli.seeding import generator
from elast_cli.shapes import Int64

Window = tuple[Tensor, Tensor, Tensor]  # stacks, actions and context, as of FrameWindows.window
NORMALIZED = 4096  # states whose frames the normalisation is fitted to


def train(inputs: Inputs, section: EncoderSection, setting: Setting) -> Trained:
    """φ and h_f, trained on frames."""
    return train_encoder(inputs.dataset, inputs.context, section, setting, outputs=inputs.outputs)


def train_encoder(
    dataset: Dataset,
    context: Tensor,
    section: EncoderSection,
    setting: Setting,
    *,
    outputs: Outputs | None = None,
) -> Trained:
    """Train φ and h_f, then measure the latents: step lengths, probes of the true state.

    Args:
        dataset: random interaction data.
        context: context vector of each episode [E,C].
        section: configuration.
        setting: seed, device, folder, memory.
        outputs: where the latents are kept for the other parts.

    Raises:
        DataError: the episodes are too short for the horizon.
    """
    seed_torch(setting.seed, "encoder")
    action_size = dataset.action.shape[1]
    model = Representation(section.net, section.cpc, action_size, context.shape[1])
    model.to(setting.device)
    features = frame_features(dataset, model.encoder, setting)
    windows = FrameWindows(dataset, features, context.to(setting.device))
    objective = objective_of(dataset, model, windows, section, setting)
    curve = objective.fit(setting)
    data = encode(dataset, context, model.encoder, setting, windows=windows, outputs=outputs)
    z, z_next = data.z[data.train], data.z[data.train + 1]
    model.scale.fit(z, z_next)
    model.step_length_quantiles.fit((z_next - z).norm(dim=1))
    spec = EncoderSpec(sizes=data.sizes, net=section.net, cpc=section.cpc)
    return Trained(model, spec, curve, _encoder_metrics(model, data, dataset, curve))


@dataclass(frozen=True)
class Objective:
    """The objective of φ and h_f (Eq. 4) on windows of the data.

    Attributes:
        model: φ and h_f.
        windows: of the dataset.
        batches: which windows make a batch.
        check: first rows of held-out windows [M].
        section: configuration.
    """

    model: Representation
    windows: FrameWindows
    batches: Starts | HardNegatives
    check: Int64
    section: EncoderSection

    def fit(self, setting: Setting) -> list[dict[str, float]]:
        """Train the module in place; the curve of its metrics."""
        config = self.section.fit
        return fit("encoder", self.module, self.loss, self.validate, config=config, setting=setting)

    @property
    def module(self) -> nn.Module:
        """What is fitted: φ and h_f, and what else their objective needs."""
        return self.model

    def loss(self, rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of a batch and its parts."""
        cpc = self.section.cpc
        rows = self.batches.batch(rng, self.section.fit.batch_size)
        still = rng.random((len(rows), cpc.horizon + 1)) < cpc.still_share
        return self.of(self.windows.window(rows, cpc.horizon, still), rng)

    def validate(self) -> dict[str, float]:
        """Mean parts of the loss on held-out windows."""
        cpc, parts = self.section.cpc, max(1, len(self.check) // self.section.fit.batch_size)
        found = [
            self.of(self.windows.window(rows, cpc.horizon))[1]
            for rows in np.array_split(self.check, parts)
        ]
        return {k: float(torch.stack([p[k] for p in found]).mean()) for k in found[0]}

    def of(
        self, window: Window, _rng: np.random.Generator | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of some windows and its parts; without a generator nothing is random."""
        return cpc_loss(self.model, *window, self.section.cpc)


@dataclass(frozen=True)
class VaeObjective(Objective):
    """The objective of a β-VAE for φ, and of h_f on its latents."""

    vae: BetaVae

    @property
    def module(self) -> nn.Module:
        """φ, h_f and the decoder."""
        return self.vae

    def of(
        self, window: Window, rng: np.random.Generator | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of some windows and its parts; without a generator the posterior's mean decoded."""
        features, shape = window[0], (window[0].shape[:2].numel(), self.section.net.latent_size)
        noise = np.zeros(shape, np.float32)
        if rng is not None:
            noise = rng.standard_normal(shape, np.float32)
        drawn = torch.from_numpy(noise).to(features.device)
        return vae_loss(self.vae, *window, drawn, self.section.vae.beta)


def objective_of(
    dataset: Dataset,
    model: Representation,
    windows: FrameWindows,
    section: EncoderSection,
    setting: Setting,
) -> Objective:
    """What φ is trained on, once its images are normalised by those for training."""
    train, val = dataset.split(setting.validation_share, setting.seed)
    cpc, horizon = section.cpc, section.cpc.horizon
    starts, held_out = dataset.starts(train, horizon), dataset.starts(val, horizon)
    if not (len(starts) and len(held_out)):
        raise DataError(
            f"no episode is longer than encoder.cpc.horizon, {horizon} steps; collect longer ones "
            "(--set collect.episode_steps=50)"
        )
    sample = generator("train", setting.seed, stream("encoder")).choice(starts, NORMALIZED)
    model.encoder.fit_normalization(windows.stacks(sample).flatten(0, 1))
    check = held_out[:: max(1, len(held_out) // VALIDATION_ROWS)][:VALIDATION_ROWS]
    if section.objective == "beta-vae":
        vae = BetaVae(model).to(setting.device)
        return VaeObjective(model, windows, Starts(starts), check, section, vae)
    batches: Starts | HardNegatives = Starts(starts)
    if cpc.lookalikes > 1:
        batches = HardNegatives(
            starts,
            lambda rows: latents(model.encoder, windows, rows + horizon).cpu().numpy(),
            group=cpc.lookalikes,
            refresh=cpc.refresh,
        )
    return Objective(model, windows, batches, check, section)


def _encoder_metrics(
    model: Representation, data: LatentData, dataset: Dataset, curve: list[dict[str, float]]
) -> dict[str, float]:
    z, action, context, z_next = data.held_out()
    with torch.no_grad():
        error = (model.dynamics(z, action, context) - z_next).norm(dim=1)
    probes = probe_state(
        data.z.cpu().numpy(), dataset.state, data.train.cpu().numpy(), data.val.cpu().numpy()
    )
    used = torch.linalg.svdvals(z - z.mean(0)).square()
    fitted = ("val_info_nce", "val_reconstruction", "val_kl")  # of one objective or the other
    return {
        **{name: curve[-1][name] for name in fitted if name in curve[-1]},
        "val_one_step_error_in_steps": float(error.mean()) / model.step_length(0.5),
        "latent_dimensions_used": float(used.sum().square() / used.square().sum()),
        **probes,
    }
