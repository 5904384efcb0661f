"""Preprocessed images in memory and in a scratch file: the same batches, the same weights."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.data import images as data_images
from elast_cli.data.dataset import Dataset
from elast_cli.errors import StorageError
from elast_cli.models.encoder.config import EncoderConfig, EncoderSection
from elast_cli.models.encoder.encode import encode
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.encoder.training import train_encoder
from elast_cli.models.encoder.windows import frame_features
from elast_cli.models.files import load_model, save_model
from elast_cli.models.frames import HeldFrames, ScratchFrames, image_features
from elast_cli.models.outputs import Outputs
from elast_cli.models.part import IMAGE_SHARE, Setting
from elast_cli.progress import Silent
from elast_cli.shapes import Int64, Uint8

EPISODES, ROWS = 12, 100
COUNT = EPISODES * ROWS
MUCH, NOTHING = 1.0, 1e-9  # GB


def setting(work: Path, memory: float = MUCH) -> Setting:
    work.mkdir(exist_ok=True)
    return Setting(0, work, torch.device("cpu"), Silent(), memory_gb=memory)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Noise, in episodes of 100 rows: blocks of images end within episodes."""
    rng = np.random.default_rng(0)
    action = rng.uniform(-1, 1, (COUNT, 2)).astype(np.float32)
    action[ROWS - 1 :: ROWS] = np.nan
    return Dataset(
        pixels=rng.integers(0, 256, (COUNT, 64, 64, 3), np.uint8),
        action=action,
        state=rng.normal(size=(COUNT, 2)).astype(np.float32),
        ep_len=np.full(EPISODES, ROWS, np.int32),
        ep_offset=np.arange(EPISODES) * ROWS,
        context=None,
    )


def contexts() -> Uint8:
    return np.random.default_rng(1).integers(0, 256, (EPISODES, 64, 64, 3), np.uint8)


def scratch(images: torch.Tensor, work: Path) -> ScratchFrames:
    return ScratchFrames(iter(images.split(7)), setting(work))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 49), min_size=1, max_size=40), st.booleans())
def test_rows_from_a_scratch_file_are_those_in_memory(
    tmp_path_factory: pytest.TempPathFactory, rows: list[int], pairs: bool
) -> None:
    images = torch.randn(50, 3, 2, 2, generator=torch.Generator().manual_seed(0)).half()
    index: Int64 = np.array(rows + rows if pairs else rows)
    index = index.reshape(2, -1) if pairs else index
    found = scratch(images, tmp_path_factory.mktemp("work")).take(index)
    assert found.dtype == torch.float16
    assert torch.equal(found, HeldFrames(images).take(index))


@pytest.mark.parametrize("with_context", [False, True])
@pytest.mark.parametrize("pool", [1, 4])
def test_features_are_the_same_bits_wherever_they_are(
    dataset: Dataset, tmp_path: Path, pool: int, with_context: bool
) -> None:
    data = replace(dataset, context=contexts()) if with_context else dataset
    phi = Encoder(EncoderConfig.model_validate({"pool": pool}))
    whole = phi.preprocess(torch.from_numpy(dataset.pixels[:]))
    if with_context:
        images = phi.preprocess(torch.from_numpy(contexts()))
        whole -= images.repeat_interleave(ROWS, 0)
    rows = np.arange(COUNT)
    for memory, kind in ((MUCH, HeldFrames), (NOTHING, ScratchFrames)):
        found = frame_features(data, phi, setting(tmp_path, memory))
        assert isinstance(found, kind)
        assert torch.equal(found.take(rows).float(), whole.float())


def test_whole_numbers_take_one_byte_each(dataset: Dataset, tmp_path: Path) -> None:
    for pool, dtype in ((1, torch.uint8), (2, torch.float16)):
        phi = Encoder(EncoderConfig.model_validate({"pool": pool}))
        assert frame_features(dataset, phi, setting(tmp_path)).take(np.array([0])).dtype == dtype


def section(**cpc: object) -> EncoderSection:
    return EncoderSection.model_validate(
        {
            "net": {"latent_size": 3, "width": 16, "pool": 4, "whiten": True},
            "cpc": {"horizon": 2, "dynamics_width": 8, "lookalikes": 4, "refresh": 5, **cpc},
            "fit": {"steps": 12, "batch_size": 32, "log_every": 4, "save_every": 5},
        }
    )


@pytest.mark.parametrize("with_context", [False, True])
def test_streamed_training_gives_the_same_weights(
    dataset: Dataset, tmp_path: Path, with_context: bool
) -> None:
    data = replace(dataset, context=contexts()) if with_context else dataset
    context = torch.ones(EPISODES, 2 if with_context else 0)
    found = []
    for memory in (MUCH, NOTHING):
        work = setting(tmp_path / f"{memory}", memory)
        found.append(train_encoder(data, context, section(), work))
    assert found[0].curve == found[1].curve
    assert found[0].metrics == found[1].metrics
    states = [trained.module.state_dict() for trained in found]
    for name, tensor in states[0].items():
        assert torch.equal(tensor, states[1][name]), name


def test_a_scratch_file_is_never_seen_and_goes_with_the_process(
    dataset: Dataset, tmp_path: Path
) -> None:
    phi = Encoder(EncoderConfig(pool=4))
    found = frame_features(dataset, phi, setting(tmp_path, NOTHING))
    assert list(tmp_path.iterdir()) == []
    assert found.take(np.array([0])).shape == (1, 3, 16, 16)


def test_a_scratch_file_that_was_cut_short_is_one_line(tmp_path: Path) -> None:
    found = scratch(torch.zeros(50, 3, 2, 2), tmp_path)
    os.ftruncate(found._file.fileno(), 100)
    with pytest.raises(StorageError, match="cut short"):
        found.take(np.array([30]))


def test_no_more_than_a_block_of_frames_is_read_at_once(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_images, "BLOCK", 256)
    asked: list[int] = []

    class Counted:
        """Images that count how many are asked for."""

        shape = dataset.pixels.shape

        def __len__(self) -> int:
            return COUNT

        def __getitem__(self, rows: slice | Int64, /) -> Uint8:
            found = dataset.pixels[rows]
            asked.append(len(found))
            return found

    train_encoder(
        replace(dataset, pixels=Counted()),
        torch.zeros(EPISODES, 0),
        section(),
        setting(tmp_path, NOTHING),
    )
    assert max(asked) == 256
    assert sum(asked) == COUNT, "every frame is read once"


def test_images_are_held_where_they_fit(tmp_path: Path) -> None:
    images = np.zeros((200, 64, 64, 3), np.uint8)
    phi = Encoder(EncoderConfig(pool=4))
    size = 200 * 3 * 16 * 16 * 2
    fits = setting(tmp_path, size / IMAGE_SHARE / 1e9 * 1.001)
    assert isinstance(image_features(images, phi, fits), HeldFrames)
    below = replace(fits, memory_gb=fits.memory_gb * 0.99)
    assert isinstance(image_features(images, phi, below), ScratchFrames)


def test_latents_are_computed_once_for_an_encoder_and_are_the_same_bits_from_its_files(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs, work = Outputs(tmp_path / "cache", "a dataset"), setting(tmp_path / "work")
    context = torch.zeros(EPISODES, 0)
    trained = train_encoder(dataset, context, section(), work, outputs=outputs)
    (tmp_path / "model").mkdir()
    save_model(tmp_path / "model", trained)
    loaded = load_model(tmp_path / "model", "encoder").encoder
    assert isinstance(loaded, Encoder)
    anew = encode(dataset, context, loaded, work)
    with monkeypatch.context() as patch:
        patch.setattr(Encoder, "forward", None)  # nothing is encoded
        kept = encode(dataset, context, loaded, work, outputs=outputs)
    for one, other in zip(vars(anew).values(), vars(kept).values(), strict=True):
        assert torch.equal(one.nan_to_num(), other.nan_to_num())


def test_other_weights_another_dataset_and_other_threads_are_encoded_anew(
    dataset: Dataset, tmp_path: Path
) -> None:
    phi = Encoder(EncoderConfig(latent_size=3, width=8))
    context, work = torch.zeros(EPISODES, 0), setting(tmp_path / "work")

    def entries(digest: str) -> int:
        encode(dataset, context, phi, work, outputs=Outputs(tmp_path / "cache", digest))
        return len(list((tmp_path / "cache").iterdir()))

    assert [entries("a"), entries("a"), entries("b")] == [1, 1, 2]
    with torch.no_grad():
        phi.mean += 1
    assert entries("a") == 3
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(threads + 1)
        assert entries("a") == 4
    finally:
        torch.set_num_threads(threads)
