"""What each learned part is trained on: batches, losses, held-out metrics and calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from pydantic import model_validator
from torch import Tensor, nn

from elast_cli.batches import Lookalikes, Starts
from elast_cli.config import StrictModel
from elast_cli.dataset import Dataset
from elast_cli.errors import DataError
from elast_cli.fit import FitConfig, fit
from elast_cli.models.cpc import CpcConfig, Representation, cpc_loss
from elast_cli.models.dynamics import DynamicsEnsemble, EnsembleConfig, LatentScale
from elast_cli.models.encoder import Encoder, EncoderConfig
from elast_cli.models.io import Sizes
from elast_cli.models.policy import LocalPolicy, PolicyConfig
from elast_cli.models.support import SupportedDynamics
from elast_cli.probe import probe_state
from elast_cli.progress import Progress
from elast_cli.seeding import derived_seed, generator
from elast_cli.shapes import FRAMES, Bool, Int64

VALIDATION_ROWS = 2048
STAGES = {"encoder": 1, "ensemble": 2, "density": 3, "policy": 4, "context": 5}


class EncoderStage(StrictModel):
    """Everything `train-encoder` needs."""

    net: EncoderConfig = EncoderConfig()
    cpc: CpcConfig = CpcConfig()
    fit: FitConfig = FitConfig(steps=8000, batch_size=256)

    @model_validator(mode="after")
    def _resumable(self) -> EncoderStage:
        if self.cpc.lookalikes > 1 and self.fit.save_every % self.cpc.refresh:
            raise ValueError("fit.save_every must be a multiple of cpc.refresh, to be resumable")
        return self


class EnsembleStage(StrictModel):
    """Everything `train-ensemble` needs."""

    net: EnsembleConfig = EnsembleConfig()
    fit: FitConfig = FitConfig(steps=10_000, batch_size=512)


class PolicyStage(StrictModel):
    """Everything `train-policy` needs."""

    net: PolicyConfig = PolicyConfig()
    fit: FitConfig = FitConfig(steps=6000, batch_size=512)


@dataclass(frozen=True)
class Trained:
    """A trained module with its training curve and final metrics."""

    module: nn.Module
    sizes: Sizes | None
    curve: list[dict[str, float]]
    metrics: dict[str, float]


@dataclass(frozen=True)
class Setting:
    """Where and how a training runs; the same for every part."""

    seed: int
    work: Path
    device: torch.device
    progress: Progress
    validation_share: float = 0.1


def seed_torch(seed: int, stage: str) -> None:
    """Make the initial weights a function of (seed, stage)."""
    torch.manual_seed(derived_seed("train", seed, STAGES[stage]))


# --- encoder ---------------------------------------------------------------------------------


def frame_features(dataset: Dataset, encoder: Encoder) -> Tensor:
    """A dataset's frames as φ takes them [N,3,S,S]: preprocessed, less their context image."""
    features = encoder.preprocess(torch.from_numpy(dataset.pixels))
    if dataset.context is not None:
        images = encoder.preprocess(torch.from_numpy(dataset.context))
        for part, image in zip(features.split(dataset.ep_len.tolist()), images, strict=True):
            part -= image
    return features


class FrameWindows:
    """Windows of states from a dataset: frames preprocessed once, stacked by index."""

    def __init__(self, dataset: Dataset, features: Tensor, context: Tensor) -> None:
        self.features, self.context = features, context  # [N,3,S,S], [E,C]
        self.actions = torch.from_numpy(dataset.action).to(features.device)
        self.episode = np.repeat(np.arange(dataset.episodes), dataset.ep_len)  # [N]
        self.first = dataset.ep_offset[self.episode]  # [N]

    def stacks(self, rows: Int64, still: Bool | None = None) -> Tensor:
        """Preprocessed stacks [M,...,F,3,S,S] of the states at `rows` [M,...].

        Where `still` [M,...] is set, the state's own frame stands in all places, as in a goal.
        """
        back = np.arange(1 - FRAMES, 1)
        if still is not None:
            back = np.where(still[..., None], 0, back)
        index = np.maximum(rows[..., None] + back, self.first[rows][..., None])
        return self.features[torch.from_numpy(index).to(self.features.device)]

    def contexts(self, rows: Int64) -> Tensor:
        """Context vectors [M,C] of the episodes that `rows` [M] lie in."""
        return self.context[torch.from_numpy(self.episode[rows]).to(self.context.device)]

    def window(
        self, rows: Int64, horizon: int, still: Bool | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """States [M,k+1,...], actions [M,k,A] and contexts [M,C] from each of `rows` on."""
        steps = rows[:, None] + np.arange(horizon + 1)
        actions = self.actions[torch.from_numpy(steps[:, :-1]).to(self.actions.device)]
        return self.stacks(steps, still), actions, self.contexts(rows)


def train_encoder(
    dataset: Dataset, context: Tensor, stage: EncoderStage, setting: Setting
) -> Trained:
    """Train φ and h_f on Eq. 4, then measure the latents: step lengths, probes of the true state.

    Args:
        dataset: random interaction data.
        context: context vector of each episode [E,C].
        stage: configuration.
        setting: seed, device, folder.

    Raises:
        DataError: the episodes are too short for the horizon.
    """
    seed_torch(setting.seed, "encoder")
    action_size = dataset.action.shape[1]
    model = Representation(stage.net, stage.cpc, action_size, context.shape[1]).to(setting.device)
    train, val = dataset.split(setting.validation_share, setting.seed)
    features = frame_features(dataset, model.encoder).to(setting.device)
    windows = FrameWindows(dataset, features, context.to(setting.device))
    horizon = stage.cpc.horizon
    starts, held_out = dataset.starts(train, horizon), dataset.starts(val, horizon)
    if not (len(starts) and len(held_out)):
        raise DataError(
            f"no episode is longer than encoder.cpc.horizon, {horizon} steps; collect longer ones "
            "(--set collect.episode_steps=50)"
        )
    sample = generator("train", setting.seed, STAGES["encoder"]).choice(starts, 4096)
    model.encoder.fit_normalization(windows.stacks(sample).flatten(0, 1))
    check = held_out[:: max(1, len(held_out) // VALIDATION_ROWS)][:VALIDATION_ROWS]
    batches: Starts | Lookalikes = Starts(starts)
    if stage.cpc.lookalikes > 1:
        batches = Lookalikes(
            starts,
            lambda rows: _latents(model, windows, rows + horizon).cpu().numpy(),
            group=stage.cpc.lookalikes,
            refresh=stage.cpc.refresh,
        )

    def loss(rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        rows = batches.batch(rng, stage.fit.batch_size)
        still = rng.random((len(rows), horizon + 1)) < stage.cpc.still_share
        return cpc_loss(model, *windows.window(rows, horizon, still), stage.cpc)

    def validate() -> dict[str, float]:
        parts = [
            cpc_loss(model, *windows.window(rows, horizon), stage.cpc)[1]
            for rows in np.array_split(check, max(1, len(check) // stage.fit.batch_size))
        ]
        return {k: float(torch.stack([p[k] for p in parts]).mean()) for k in parts[0]}

    curve = fit(
        model,
        loss,
        config=stage.fit,
        seed=setting.seed,
        stage=STAGES["encoder"],
        label="encoder",
        work=setting.work,
        validate=validate,
        progress=setting.progress,
    )
    data = encode(dataset, context, model, setting)
    z, z_next = data.z[data.train], data.z[data.train + 1]
    model.scale.fit(z, z_next)
    model.step_length_quantiles.fit((z_next - z).norm(dim=1))
    sizes = Sizes(
        latent=stage.net.latent_size,
        action=action_size,
        context=context.shape[1],
        state=dataset.state.shape[1],
    )
    return Trained(model, sizes, curve, _encoder_metrics(model, data, dataset, curve))


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


# --- models on frozen latents ----------------------------------------------------------------


@dataclass(frozen=True)
class LatentData:
    """A whole dataset encoded.

    Attributes:
        z, action, context: latents [N,Z], actions [N,A], contexts [N,C].
        state: true states [N,S], kept only so that people can read plans and probes.
        train, val: rows at which a transition starts.
    """

    z: Tensor
    action: Tensor
    context: Tensor
    state: Tensor
    train: Tensor
    val: Tensor

    @property
    def sizes(self) -> Sizes:
        """Sizes of the models trained on this data."""
        return Sizes(
            latent=self.z.shape[1],
            action=self.action.shape[1],
            context=self.context.shape[1],
            state=self.state.shape[1],
        )

    def transitions(self, rows: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """z [M,Z], a [M,A], c [M,C], z' [M,Z] of the transitions that start at `rows` [M]."""
        return self.z[rows], self.action[rows], self.context[rows], self.z[rows + 1]

    def batch(self, rng: np.random.Generator, size: int) -> Tensor:
        """Rows [size] of training transitions, uniform with replacement."""
        pick = torch.from_numpy(rng.integers(len(self.train), size=size))
        return self.train[pick.to(self.train.device)]

    def check_rows(self) -> Tensor:
        """At most `VALIDATION_ROWS` held-out transitions, evenly spaced."""
        return self.val[:: max(1, len(self.val) // VALIDATION_ROWS)][:VALIDATION_ROWS]


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
        z=_latents(model, windows, rows),
        action=windows.actions,
        context=windows.contexts(rows),
        state=torch.from_numpy(dataset.state).to(device),
        train=torch.from_numpy(dataset.starts(train, 1)).to(device),
        val=torch.from_numpy(dataset.starts(val, 1)).to(device),
    )


@torch.no_grad()
def _latents(model: Representation, windows: FrameWindows, rows: Int64) -> Tensor:
    """Latents [M,Z] of the states at `rows` [M]."""
    parts = [
        model.encoder(windows.stacks(part))
        for part in np.array_split(rows, max(1, len(rows) // 1024))
    ]
    return torch.cat(parts)


def fit_on_latents(
    module: nn.Module,
    data: LatentData,
    loss: Callable[[np.random.Generator, int], tuple[Tensor, dict[str, Tensor]]],
    validate: Callable[[Tensor], dict[str, float]],
    *,
    name: str,
    config: FitConfig,
    setting: Setting,
) -> list[dict[str, float]]:
    """Run the training loop for one of the models on frozen latents."""
    check = data.check_rows()
    return fit(
        module,
        lambda rng: loss(rng, config.batch_size),
        config=config,
        seed=setting.seed,
        stage=STAGES[name],
        label=name,
        work=setting.work,
        validate=lambda: validate(check),
        progress=setting.progress,
    )


def fit_scale(scale: LatentScale, data: LatentData) -> None:
    """Fit a model's scale to the transitions for training."""
    z, _, _, z_next = data.transitions(data.train)
    scale.fit(z, z_next)


def train_ensemble(data: LatentData, stage: EnsembleStage, setting: Setting) -> Trained:
    """Train H_f's members, each on its own batches, then calibrate variance and support."""
    seed_torch(setting.seed, "ensemble")
    size = min(stage.net.support_size, len(data.train))
    config, sizes = stage.net.model_copy(update={"support_size": size}), data.sizes
    dynamics = SupportedDynamics(
        config,
        latent_size=sizes.latent,
        action_size=sizes.action,
        context_size=sizes.context,
        state_size=sizes.state,
    ).to(setting.device)
    model = dynamics.ensemble
    fit_scale(model.scale, data)
    members = stage.net.members

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        rows = data.batch(rng, members * size)
        parts = data.transitions(rows)
        z, action, context, z_next = (part.unflatten(0, (members, size)) for part in parts)
        target = (z_next - z) / model.scale.step
        error = (model.members(z, action, context) - target).square().mean()
        return members * error, {"mse": error}

    def validate(rows: Tensor) -> dict[str, float]:
        z, action, context, z_next = data.transitions(rows)
        predicted, _ = model(z, action, context)
        return {"mse": float(((predicted - z_next) / model.scale.step).square().mean())}

    curve = fit_on_latents(
        model, data, loss, validate, name="ensemble", config=stage.fit, setting=setting
    )
    metrics = {"val_mse": curve[-1]["val_mse"], **_calibrate_dynamics(dynamics, data, setting)}
    return Trained(dynamics, sizes, curve, metrics)


@torch.no_grad()
def _calibrate_dynamics(
    dynamics: SupportedDynamics, data: LatentData, setting: Setting
) -> dict[str, float]:
    """Fill the support and both quantile tables; returns held-out errors in median steps."""
    support = dynamics.support
    rng = generator("train", setting.seed, STAGES["ensemble"])
    pick = rng.choice(len(data.train), len(support.rows), replace=False)
    rows = data.train[torch.from_numpy(np.sort(pick)).to(data.train.device)]
    support.rows.copy_(rows)
    support.latents.copy_(data.z[rows])
    support.states.copy_(data.state[rows])
    z, action, context, z_next = data.transitions(data.val)
    predicted, variance = dynamics.ensemble(z, action, context)
    distance = support.distance(predicted)
    dynamics.ensemble.variance_quantiles.fit(variance)
    support.distance_quantiles.fit(distance)
    step = float((z_next - z).norm(dim=1).median())
    return {
        "val_one_step_error_in_steps": float((predicted - z_next).norm(dim=1).mean()) / step,
        "val_support_distance_p99_in_steps": support.distance_quantiles.at(0.99) / step,
    }


def train_policy(
    data: LatentData, ensemble: DynamicsEnsemble, stage: PolicyStage, setting: Setting
) -> Trained:
    """Train π on one-step transitions, then calibrate the round trip through H_f."""
    seed_torch(setting.seed, "policy")
    sizes = data.z.shape[1], data.action.shape[1], data.context.shape[1]
    model = LocalPolicy(stage.net, *sizes).to(setting.device)
    fit_scale(model.scale, data)

    def error(rows: Tensor) -> Tensor:
        z, action, context, z_next = data.transitions(rows)
        value: Tensor = (model(z, z_next, context) - action).square().mean()
        return value

    def loss(rng: np.random.Generator, size: int) -> tuple[Tensor, dict[str, Tensor]]:
        value = error(data.batch(rng, size))
        return value, {"mse": value}

    curve = fit_on_latents(
        model,
        data,
        loss,
        lambda rows: {"mse": float(error(rows))},
        name="policy",
        config=stage.fit,
        setting=setting,
    )
    with torch.no_grad():
        z, _, context, z_next = data.transitions(data.val)
        back, _ = ensemble(z, model(z, z_next, context), context)
        miss = (back - z_next).norm(dim=1)
    model.round_trip_quantiles.fit(miss)
    length = float((z_next - z).norm(dim=1).median())
    metrics = {
        "val_mse": curve[-1]["val_mse"],
        "val_round_trip_in_steps": float(miss.mean()) / length,
    }
    return Trained(model, data.sizes, curve, metrics)
