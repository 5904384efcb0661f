from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from elast_cli.inference.frames import FrameEncoder, pooled
from elast_cli.inference.latent_world import LatentWorld, PolicyCall
from elast_cli.inference.rollout import CemRollout
from elast_cli.models.encoder.config import EncoderConfig
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.files import arrays_of, stored
from elast_cli.models.nets import ForwardModel
from elast_cli.shapes import FRAMES, Float32
from tests.toys.models import ACTION, CONTEXT, LATENT, SIZES, models, trained

ROWS = 100
SCENARIOS = 4


@pytest.fixture
def parts() -> dict[str, Any]:
    return dict(models())


def world_of(
    parts: dict[str, Any], forward_model: ForwardModel | None = None, context: int = CONTEXT
) -> LatentWorld:
    sizes = SIZES.model_copy(update={"context": context})
    return LatentWorld(
        ensemble=stored(trained(parts["ensemble"], sizes)),
        density=stored(trained(parts["density"], sizes)),
        policy=stored(trained(parts["policy"], sizes)),
        forward_model=arrays_of(forward_model.net) if forward_model else None,
    ).at(array(SCENARIOS, context))


def frame_encoder(encoder: Encoder) -> FrameEncoder:
    return FrameEncoder(encoder.config, arrays_of(encoder))


def array(*shape: int, seed: int = 0) -> Float32:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def tensors(*arrays: NDArray[Any]) -> list[torch.Tensor]:
    return [torch.from_numpy(x) for x in arrays]


Z, Z_NEXT = array(ROWS, LATENT, seed=1), array(ROWS, LATENT, seed=2)
ACTIONS = array(ROWS, ACTION, seed=3).clip(-1, 1)
ROW = np.random.default_rng(4).integers(SCENARIOS, size=ROWS)
CONTEXTS = array(SCENARIOS, CONTEXT)[ROW]


def test_a_step_is_the_ensembles(parts: dict[str, Any]) -> None:
    z_next, variance = world_of(parts).step(Z, ACTIONS, ROW)
    mean, spread = parts["ensemble"].ensemble(*tensors(Z, ACTIONS, CONTEXTS))
    np.testing.assert_allclose(z_next, mean, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(variance, spread, rtol=1e-4, atol=1e-6)


def test_with_a_forward_model_it_alone_predicts(parts: dict[str, Any]) -> None:
    forward = parts["encoder"].dynamics
    world = world_of(parts, forward)
    z_next, variance = world.step(Z, ACTIONS, ROW)
    np.testing.assert_allclose(
        z_next, forward(*tensors(Z, ACTIONS, CONTEXTS)), rtol=1e-4, atol=1e-5
    )
    assert not variance.any()
    assert (world.members, world_of(parts).members) == (1, 3)


@pytest.mark.parametrize("near_share", [0.8, 0.0])
def test_the_density_of_pairs_is_the_plain_one(parts: dict[str, Any], near_share: float) -> None:
    psi = parts["density"]
    psi.config = psi.config.model_copy(update={"near_share": near_share})
    world = world_of(parts)
    table = np.concatenate([world.features(Z, ROW), world.features(Z_NEXT, ROW)])
    assert table.shape == (2 * ROWS, world.feature_size)
    pair = np.arange(ROWS)
    found = world.log_density(table, pair, pair + ROWS)
    expected = parts["density"](*tensors(Z, Z_NEXT, CONTEXTS))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_a_latent_is_supported_where_a_training_state_is_near(parts: dict[str, Any]) -> None:
    world = world_of(parts)
    gap = np.linalg.norm(Z[:, None] - parts["ensemble"].support.latents.numpy(), axis=2).min(1)
    for limit in (np.quantile(gap, 0.5) * 1.001, 2 * gap.max(), gap.min() / 2):
        np.testing.assert_array_equal(world.supported(Z, float(limit)), gap <= limit)


def test_the_world_acts_as_the_policy_does(parts: dict[str, Any]) -> None:
    action = world_of(parts).act(Z, Z_NEXT, ROW)
    expected = parts["policy"](*tensors(Z, Z_NEXT, CONTEXTS))
    np.testing.assert_allclose(action, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("size", [1, 2, 3, 8, 31, 32, 33, 64])
def test_an_item_never_depends_on_its_batch_to_the_bit(parts: dict[str, Any], size: int) -> None:
    for world in (world_of(parts), world_of(parts, parts["encoder"].dynamics)):
        table = world.features(Z, ROW)
        pair = np.arange(ROWS)
        other = ROWS - 1 - pair

        def results(
            at: NDArray[np.int64],
            world: LatentWorld = world,
            table: Float32 = table,
            other: NDArray[np.int64] = other,
        ) -> list[NDArray[Any]]:
            return [
                *world.step(Z[at], ACTIONS[at], ROW[at]),
                world.features(Z[at], ROW[at]),
                world.log_density(table, at, other[at]),
                world.supported(Z[at], 1.5),
                world.act(Z[at], Z_NEXT[at], ROW[at]),
            ]

        shuffled = np.random.default_rng(size).permutation(ROWS)
        chunks = [results(shuffled[i : i + size]) for i in range(0, ROWS, size)]
        for whole, *few in zip(results(shuffled), *chunks, strict=True):
            np.testing.assert_array_equal(whole, np.concatenate(few))


def test_no_items_are_no_trouble(parts: dict[str, Any]) -> None:
    world, none = world_of(parts), np.zeros(0, np.int64)
    assert world.log_density(world.features(Z, ROW), none, none).shape == (0,)
    assert world.supported(Z[:0], 1.0).shape == (0,)
    assert world.step(Z[:0], ACTIONS[:0], none)[0].shape == (0, LATENT)
    assert world.features(Z[:0], none).shape == (0, world.feature_size)


def test_a_task_may_have_no_context() -> None:
    parts: dict[str, Any] = dict(models(context=0))
    world = world_of(parts, context=0)
    table, pair = world.features(Z, ROW), np.arange(ROWS - 1)
    expected = parts["density"](*tensors(Z[:-1], Z[1:], np.zeros((ROWS - 1, 0), np.float32)))
    found = world.log_density(table, pair, pair + 1)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("pool", [1, 2, 4, 8])
def test_frames_are_pooled_as_in_training_to_the_bit(pool: int) -> None:
    encoder = Encoder(EncoderConfig.model_validate({"pool": pool, "width": 8}))
    frames = np.random.default_rng(0).integers(256, size=(5, 64, 64, 3), dtype=np.uint8)
    expected = encoder.preprocess(torch.from_numpy(frames)).numpy()
    found = pooled(frames, pool)
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
def test_the_frame_encoder_is_the_encoder_row_by_row(architecture: str) -> None:
    encoder: Any = models(architecture=architecture)["encoder"]
    frames = np.random.default_rng(0).integers(256, size=(5, FRAMES, 64, 64, 3), dtype=np.uint8)
    call = frame_encoder(encoder.encoder)
    latent = call(frames, None)
    features = encoder.encoder.preprocess(torch.from_numpy(frames).flatten(0, 1))
    expected = encoder.encoder(features.unflatten(0, (5, FRAMES)))
    np.testing.assert_allclose(latent, expected, rtol=1e-4, atol=1e-5)
    for b in range(5):
        np.testing.assert_array_equal(call(frames[b : b + 1], None)[0], latent[b])


@pytest.mark.parametrize("whiten", [False, True])
@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
def test_the_frame_encoder_of_one_frame_is_the_encoder(architecture: str, whiten: bool) -> None:
    keys = {"architecture": architecture, "frames": 1, "width": 16, "channels": 4, "whiten": whiten}
    encoder = Encoder(EncoderConfig.model_validate(keys)).eval()
    noise = torch.rand(50, 3, encoder.side, encoder.side, generator=torch.manual_seed(0))
    encoder.fit_normalization(200 * noise[:, :1] + 50 * noise)
    frames = np.random.default_rng(0).integers(256, size=(4, FRAMES, 64, 64, 3), dtype=np.uint8)
    features = encoder.preprocess(torch.from_numpy(frames[:, -1]))
    with torch.no_grad():
        expected = encoder(features[:, None]).numpy()
    latent = frame_encoder(encoder)(frames, None)
    np.testing.assert_allclose(latent, expected, rtol=1e-4, atol=1e-4)
    for b in range(4):
        np.testing.assert_array_equal(frame_encoder(encoder)(frames[b : b + 1], None)[0], latent[b])


@pytest.mark.parametrize("architecture", ["pooled-mlp", "conv"])
def test_the_frame_encoder_takes_a_rows_context_image_off_its_frames(architecture: str) -> None:
    encoder: Any = models(architecture=architecture)["encoder"]
    rng = np.random.default_rng(0)
    frames = rng.integers(256, size=(4, FRAMES, 64, 64, 3), dtype=np.uint8)
    images = rng.integers(256, size=(4, 64, 64, 3), dtype=np.uint8)
    call = frame_encoder(encoder.encoder)
    latent = call(frames, images)
    less = (frames - images[:, None].astype(np.float32)).reshape(-1, 64, 64, 3)
    features = encoder.encoder.preprocess(torch.from_numpy(less)).unflatten(0, (4, FRAMES))
    np.testing.assert_allclose(latent, encoder.encoder(features), rtol=0.01, atol=0.01)
    assert not np.allclose(latent, call(frames, images[::-1].copy()), atol=0.01)
    for b in range(4):
        np.testing.assert_array_equal(call(frames[b : b + 1], images[b : b + 1])[0], latent[b])


def test_the_policy_call_is_the_policy_row_by_row(parts: dict[str, Any]) -> None:
    call = PolicyCall(stored(trained(parts["policy"])))
    action = call(Z, Z_NEXT, CONTEXTS)
    np.testing.assert_allclose(
        action, parts["policy"](*tensors(Z, Z_NEXT, CONTEXTS)), rtol=1e-4, atol=1e-5
    )
    np.testing.assert_array_equal(call(Z[7:8], Z_NEXT[7:8], CONTEXTS[7:8])[0], action[7])


def test_the_rollout_is_the_forward_model_step_by_step(parts: dict[str, Any]) -> None:
    forward = parts["encoder"].dynamics
    actions, context = torch.rand(6, 4, ACTION) * 2 - 1, torch.randn(CONTEXT)
    start = torch.from_numpy(Z[0])
    path = CemRollout(forward, ACTION)(start, actions, context)
    z, contexts = start.expand(6, -1), context.expand(6, -1)
    for t in range(4):
        z = forward(z, actions[:, t], contexts)
        torch.testing.assert_close(path[:, t], z)
    assert start.equal(torch.from_numpy(Z[0]))


@pytest.mark.parametrize("single", [False, True])
def test_slopes_are_what_small_changes_do(parts: dict[str, Any], single: bool) -> None:
    world = world_of(parts, parts["encoder"].dynamics if single else None)
    row = int(ROW[0])
    slopes = world.slopes(Z, ACTIONS, row)
    assert slopes.shape == (ROWS, LATENT, LATENT + ACTION)
    rng = np.random.default_rng(5)
    by_z = 1e-3 * rng.standard_normal(Z.shape, dtype=np.float32)
    by_a = 1e-3 * rng.standard_normal(ACTIONS.shape, dtype=np.float32)
    rows = np.full(ROWS, row)
    moved = world.step(Z + by_z, ACTIONS + by_a, rows)[0] - world.step(Z, ACTIONS, rows)[0]
    expected = np.einsum("mzi,mi->mz", slopes, np.concatenate([by_z, by_a], 1))
    near = np.linalg.norm(moved - expected, axis=1) < 0.02 * np.linalg.norm(moved, axis=1)
    assert near.mean() > 0.9  # the others step over a kink
