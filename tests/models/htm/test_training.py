"""Training HTM's connectivity and inverse model: which pairs, resuming, and what is learned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError
from elast_cli.models.cvae.config import CvaeConfig, CvaeSection, ElboConfig
from elast_cli.models.cvae.images import ImagePairs
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.cvae.training import train as train_cvae
from elast_cli.models.files import save_model
from elast_cli.models.htm.config import HtmConfig, HtmSection, PairConfig
from elast_cli.models.htm.pairs import PairSource
from elast_cli.models.htm.training import train
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import FitConfig, Setting, Trained
from tests.toys.goals import moving_square, setting
from tests.toys.killed import assert_killed_ends_as_whole

NET = CvaeConfig(latent_size=6, channels=4, pool=4)


def dataset_of(*, contexts: bool, episodes: int = 12, rows: int = 6) -> Dataset:
    """A moving square, perhaps before a background of the episode's brightness."""
    dataset = moving_square(episodes, rows)
    if not contexts:
        return dataset
    images = np.zeros((episodes, 64, 64, 3), np.uint8)
    images[:] = 10 * np.arange(episodes, dtype=np.uint8)[:, None, None, None]
    return replace(dataset, context=images)


def training(
    dataset: Dataset, place: Setting, steps: int = 60
) -> Callable[[HtmSection, Setting], Trained]:
    """Trainings on an autoencoder of some steps."""
    fit = FitConfig(steps=steps, batch_size=32, learning_rate=3e-3, log_every=100)
    section = CvaeSection(net=NET, elbo=ElboConfig(kl_weight=0.3), fit=fit)
    cvae = train_cvae(Inputs(dataset, {}, place), section, place)
    folder = place.work / "cvae"
    folder.mkdir()
    save_model(folder, cvae)
    return lambda section, where: train(Inputs(dataset, {"cvae": folder}, where), section, where)


def section(steps: int, batch_size: int = 16, **pairs: object) -> HtmSection:
    return HtmSection(
        net=HtmConfig(width=16, depth=2, score_scale=10),
        pairs=PairConfig.model_validate({"negatives": 8, "per_context": 4, **pairs}),
        fit=FitConfig(
            steps=steps, batch_size=batch_size, learning_rate=3e-3, log_every=100, save_every=2
        ),
    )


@pytest.mark.parametrize("contexts", [False, True])
def test_a_killed_training_ends_as_one_that_was_not(
    contexts: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trains = training(dataset_of(contexts=contexts), setting(tmp_path / "cvae"), steps=3)
    # the last checkpoint is of step 4
    assert_killed_ends_as_whole(
        lambda place: trains(section(7), place), (PairSource, "batch"), 6, tmp_path, monkeypatch
    )


def source(dataset: Dataset, place: Setting, config: PairConfig) -> PairSource:
    torch.manual_seed(0)
    cvae = Cvae(NET, has_context=dataset.context is not None).eval()
    return PairSource(dataset, ImagePairs.of(dataset, cvae, place), cvae, config)


def test_pairs_of_one_context_lie_together_and_share_negatives(tmp_path: Path) -> None:
    dataset = dataset_of(contexts=True)
    found = source(dataset, setting(tmp_path), PairConfig(negatives=3, per_context=4))
    starts, rng = dataset.starts(np.array([2, 5, 7, 11]), 1), np.random.default_rng(0)
    rows, groups = found.rows(starts, rng, 18)
    assert (groups, len(rows)) == (4, 16)
    episode = dataset.episode[rows].reshape(4, 4)
    assert (episode == episode[:, :1]).all()
    assert set(episode.ravel().tolist()) <= {2, 5, 7, 11}
    assert np.isin(rows, starts).all()
    batch = found.batch(starts, rng, 16)
    assert batch.images[0].shape == batch.images[1].shape == (32, 3, 16, 16)
    assert len(batch.shown) == len(batch.shown_context) == 32 + 4 * 3
    before, after, made = batch.shown_context[:, 0, 0, 0].split([16, 16, 12])
    assert torch.equal(before, after)
    assert torch.equal(made.reshape(4, 3), before.reshape(4, 4)[:, :3])


def test_without_contexts_all_pairs_share_the_negatives(tmp_path: Path) -> None:
    dataset = dataset_of(contexts=False)
    found = source(dataset, setting(tmp_path), PairConfig(negatives=3))
    batch = found.batch(dataset.starts(np.arange(12), 1), np.random.default_rng(0), 10)
    assert (batch.groups, len(batch.shown), batch.shown_context.shape[1]) == (1, 23, 0)


@pytest.mark.parametrize("ahead", [1, 3])
def test_a_positive_lies_one_to_a_few_steps_ahead(ahead: int, tmp_path: Path) -> None:
    dataset = dataset_of(contexts=False, rows=8)
    place = np.arange(len(dataset.pixels), dtype=np.uint8)  # an image shows its row
    dataset = replace(dataset, pixels=np.zeros_like(dataset.pixels) + place[:, None, None, None])
    found = source(dataset, setting(tmp_path), PairConfig(ahead=ahead, negatives=1))
    starts = dataset.starts(np.arange(12), ahead)
    batch = found.batch(starts, np.random.default_rng(0), 200)
    rows = (255 * batch.images[0][:, 0, 0, 0]).round().long().reshape(2, 200)
    assert set((rows[1] - rows[0]).tolist()) == {*range(1, ahead + 1)}
    np.testing.assert_array_equal(batch.action, dataset.action[rows[0].numpy()])


def test_it_learns_which_image_follows_and_by_which_action(tmp_path: Path) -> None:
    dataset = dataset_of(contexts=False, episodes=150, rows=4)
    trains = training(dataset, setting(tmp_path / "cvae"), steps=250)
    on = {"inverse_on": "reconstructions", "negatives": 20}
    made = trains(section(200, 32, **on), setting(tmp_path / "htm"))
    assert made.metrics["val_info_nce"] < 0.85 * np.log(21)  # that of a score that knows nothing
    assert made.metrics["val_accuracy"] > 3 / 21
    assert made.metrics["val_action_r2"] > 0.2


def test_pairs_further_apart_than_episodes_are_long_are_refused(tmp_path: Path) -> None:
    trains = training(dataset_of(contexts=False), setting(tmp_path / "cvae"), steps=1)
    with pytest.raises(DataError, match=r"longer than htm\.pairs\.ahead, 9 steps"):
        trains(section(2, ahead=9), setting(tmp_path / "htm"))
