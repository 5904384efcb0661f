"""Training of the conditional variational autoencoder, and its measures on unseen frames."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor, nn

from elast_cli.data.dataset import Dataset
from elast_cli.models.cvae.config import CvaeSection, CvaeSpec
from elast_cli.models.cvae.images import ImagePairs, as_bytes
from elast_cli.models.cvae.net import Cvae, negative_elbo
from elast_cli.models.fit import fit
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import Reconstructions, Setting, Trained, seed_torch, stream
from elast_cli.models.probe import probe_state, thinned
from elast_cli.seeding import generator
from elast_cli.shapes import Float32, Int64

KIND = "cvae"
CHECKED = 512  # held-out frames that are decoded at every logged step
PROBED = 4000  # frames for training a probe of the true state; a quarter as many to measure it
SHOWN, SAMPLES = 8, 4  # columns of the picture, and samples in each
CHUNK = 64  # images at once


def train(inputs: Inputs, section: CvaeSection, setting: Setting) -> Trained:
    """The autoencoder, trained on single frames and, where there are any, context images.

    Args:
        inputs: the dataset.
        section: configuration.
        setting: seed, device, folder, memory.
    """
    seed_torch(setting.seed, KIND)
    dataset = inputs.dataset
    spec = CvaeSpec(net=section.net, has_context=dataset.context is not None)
    model = spec.build().to(setting.device)
    pairs = ImagePairs.of(dataset, model, setting)
    episodes = dataset.split(setting.validation_share, setting.seed)
    rows, held_out = (dataset.starts(part, 0) for part in episodes)
    check = thinned(held_out, CHECKED)

    def loss(rng: np.random.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        picked = rows[rng.integers(len(rows), size=section.fit.batch_size)]
        noise = normal(rng, (len(picked), section.net.latent_size)).to(setting.device)
        weight = section.elbo.weight_at(int(model.steps), section.fit.steps)
        model.steps += 1
        return negative_elbo(model, *pairs.take(picked), noise, weight)

    def validate() -> dict[str, float]:
        return held_out_loss(model, pairs, check)

    curve = fit(KIND, model, loss, validate, config=section.fit, setting=setting)
    metrics = {**validate(), **_probes(model, pairs, dataset, rows, held_out)}
    metrics = {f"val_{name}": value for name, value in metrics.items()}
    return Trained(model, spec, curve, metrics, _shown(model, pairs, held_out, setting))


def normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Tensor:
    """Standard normal noise, float32."""
    return torch.from_numpy(rng.standard_normal(shape, np.float32))


@contextmanager
def evaluating(model: nn.Module) -> Iterator[None]:
    """Normalise by the running statistics, which stay as they are; without gradients."""
    trains = model.training
    model.eval()
    try:
        with torch.no_grad():
            yield
    finally:
        model.train(trains)


def held_out_loss(model: Cvae, pairs: ImagePairs, rows: Int64) -> dict[str, float]:
    """Mean parts of the objective, decoded from mean latents, and the error.

    `rmse` is in grey levels of 0 to 255. `bce_excess` is what the cross-entropy has above its least
    value, that of a perfect reconstruction.

    Args:
        model: the autoencoder.
        pairs: images and their contexts.
        rows: of held-out images, i64 [M].
    """
    found: list[Tensor] = []
    with evaluating(model):
        for part in _parts(rows):
            images, context = pairs.take(part)
            nothing = images.new_zeros(len(part), model.config.latent_size)
            _, terms = negative_elbo(model, images, context, nothing, 0.0)
            least = torch.special.entr(images) + torch.special.entr(1 - images)
            excess = terms["bce"] - least.sum() / len(part)
            error = (model.reconstructed(images, context) - images).square().mean()
            found.append(len(part) * torch.stack([terms["bce"], terms["kl"], excess, error]))
    bce, kl, excess, error = (torch.stack(found).sum(0) / len(rows)).tolist()
    return {"bce": bce, "kl": kl, "bce_excess": excess, "rmse": 255 * error**0.5}


def _parts(rows: Int64) -> list[Int64]:
    """Rows in parts of at most `CHUNK`."""
    return np.array_split(rows, -(-len(rows) // CHUNK))


def _probes(
    model: Cvae, pairs: ImagePairs, dataset: Dataset, rows: Int64, held_out: Int64
) -> dict[str, float]:
    """How much of the true state the mean latents hold."""
    some, unseen = thinned(rows, PROBED), thinned(held_out, PROBED // 4)
    every = np.concatenate([some, unseen])
    with evaluating(model):
        latents = [model.encoder(*pairs.take(part)).cpu().numpy() for part in _parts(every)]
    z: Float32 = np.concatenate(latents)
    place = np.arange(len(every))
    found = probe_state(z, dataset.state[every], place[: len(some)], place[len(some) :])
    return found


def _shown(model: Cvae, pairs: ImagePairs, held_out: Int64, setting: Setting) -> Reconstructions:
    """A few held-out frames, their reconstructions, and samples in the same contexts."""
    rows = thinned(held_out, SHOWN)[:SHOWN]
    rng = generator("train", setting.seed, stream(KIND))
    with evaluating(model):
        images, context = pairs.take(rows)
        noise = normal(rng, (SAMPLES, len(rows), model.config.latent_size)).to(setting.device)
        prior = model.prior_of(context)
        decoded = {"reconstructed": as_bytes(model.reconstructed(images, context))}
        for i in range(SAMPLES):
            decoded[f"sample {i + 1}"] = as_bytes(model.images(prior.at(noise[i])))
    labels = [f"episode {episode}" for episode in pairs.episode[rows]]
    return Reconstructions(as_bytes(images), decoded, labels)
