"""How good a model is on held-out episodes: images, predictions, and probes of the state."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.models.part import Reconstructions
from elast_cli.models.probe import PROBE_ROWS, probe_state, thinned
from elast_cli.models.rssm.elbo import Sequences, mean_of
from elast_cli.models.rssm.images import grey_levels, shown
from elast_cli.models.rssm.net import Rssm
from elast_cli.models.rssm.sequences import SequenceData, sequence_starts
from elast_cli.shapes import Float32, Int64

SEEN = 5  # frames that a prediction begins with, as in the authors' code
CHECKED = 32  # sequences that are predicted
SHOWN = 10  # frames in the picture
LONGEST = 200  # frames of an episode that are filtered for probes
TOGETHER = 4  # episodes that are filtered at once


@torch.no_grad()
def measured(
    model: Rssm, data: SequenceData, dataset: Dataset, split: tuple[Int64, Int64], length: int
) -> tuple[dict[str, float], Reconstructions]:
    """Metrics of a trained model, and a held-out sequence as it sees and predicts it.

    Errors are root mean squares in grey levels of 0 to 255. Step lengths are fitted in place.

    Args:
        model: trained.
        data: frames and actions.
        dataset: the true states.
        split: episodes for training and for validation.
        length: frames of a sequence.
    """
    means, rows = zip(*(filtered_means(model, data, dataset, part) for part in split), strict=True)
    z, at = np.concatenate(means), np.concatenate(rows)
    steps = np.linalg.norm(np.diff(means[0], axis=0), axis=1)
    same_episode = np.diff(dataset.episode[rows[0]]) == 0
    model.step_length_quantiles.fit(torch.from_numpy(steps[same_episode]))
    ours = np.arange(len(z))
    probes = probe_state(z, dataset.state[at], ours[: len(rows[0])], ours[len(rows[0]) :])
    first = thinned(sequence_starts(dataset, split[1], length), CHECKED)
    errors, picture = _predicted(model, data.take(first, length), dataset.episode[first])
    return {**errors, **probes}, picture


def filtered_means(
    model: Rssm, data: SequenceData, dataset: Dataset, episodes: Int64
) -> tuple[Float32, Int64]:
    """Means of the posterior f32 [M,S] at rows i64 [M]: all frames of some of these episodes.

    Args:
        model: filters the frames.
        data: sequences of the dataset.
        dataset: whose episodes they are.
        episodes: to choose from, i64 [E].
    """
    length = min(LONGEST, int(dataset.ep_len[episodes].max()))
    some = thinned(episodes, max(1, 4 * PROBE_ROWS // length))
    means, rows = [], []
    for part in np.array_split(some, -(-len(some) // TOGETHER)):
        first = dataset.ep_offset[part]
        batch = data.take(first, length)
        at, known = data.rows(first, length)
        found = model.filtered(model.embed(batch.images), batch.action)
        means.append(found.state.cpu().numpy()[known])
        rows.append(at[known])
    return np.concatenate(means), np.concatenate(rows)


def _predicted(
    model: Rssm, batch: Sequences, episode: Int64
) -> tuple[dict[str, float], Reconstructions]:
    """Errors of images that are seen, and of those predicted open loop after the first few."""
    found = model.filtered(model.embed(batch.images), batch.action)
    seen = min(SEEN, int(batch.known.sum(1).max()) // 2)
    now = found.state[:, seen - 1], found.belief[:, seen - 1]
    predicted = model.decode(*model.imagined(*now, batch.action[:, seen:]))
    decoded = model.decode(found.state, found.belief)
    truth, later = batch.images[:, seen:], batch.known[:, seen:]
    still = batch.images[:, seen - 1 : seen].expand_as(truth)
    errors = {
        "val_reconstruction_rmse": _rmse(decoded, batch.images, batch.known),
        "val_open_loop_rmse": _rmse(predicted, truth, later),
        "val_no_change_rmse": _rmse(still, truth, later),
    }
    open_loop = torch.cat([decoded[:, :seen], predicted], dim=1)
    one = int(batch.known.sum(1).argmax())
    steps = np.linspace(0, int(batch.known[one].sum()) - 1, SHOWN).round().astype(int)
    steps = np.unique(steps)
    rows = {"posterior": decoded, f"open loop from {seen}": open_loop}
    return errors, Reconstructions(
        images=shown(batch.images[one, steps]),
        decoded={name: shown(images[one, steps]) for name, images in rows.items()},
        labels=[f"episode {episode[one]}", *(f"step {step}" for step in steps[1:])],
    )


def _rmse(one: Tensor, other: Tensor, known: Tensor) -> float:
    error = (grey_levels(one) - grey_levels(other)).square().mean((2, 3, 4))
    return float(mean_of(error, known).sqrt())
