"""Every learned part on a tiny world: a bright square on a dark floor, moved by its action."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from elast_cli.data.dataset import Dataset
from elast_cli.errors import DataError
from elast_cli.models.density.config import DensityConfig, DensitySection
from elast_cli.models.density.net import TransitionDensity
from elast_cli.models.density.noise import OtherContexts
from elast_cli.models.density.training import train_density
from elast_cli.models.encoder.config import CpcConfig, EncoderConfig, EncoderSection, EncoderSpec
from elast_cli.models.encoder.cpc import Representation
from elast_cli.models.encoder.encode import encode
from elast_cli.models.encoder.hard_negatives import Starts
from elast_cli.models.encoder.net import Encoder
from elast_cli.models.encoder.training import train_encoder
from elast_cli.models.encoder.windows import FrameWindows, frame_features
from elast_cli.models.ensemble.config import EnsembleConfig, EnsembleSection
from elast_cli.models.ensemble.net import DynamicsEnsemble
from elast_cli.models.ensemble.support import SupportedDynamics
from elast_cli.models.ensemble.training import train_ensemble
from elast_cli.models.frames import HeldFrames
from elast_cli.models.latents import LatentData
from elast_cli.models.part import FitConfig, Trained
from elast_cli.models.policy.config import PolicyConfig, PolicySection
from elast_cli.models.policy.net import LocalPolicy
from elast_cli.models.policy.training import train_policy
from tests.toys.square import EPISODES, ROWS, recorded, setting

ENCODER = EncoderSection(
    net=EncoderConfig(latent_size=3, width=32, pool=4),
    cpc=CpcConfig(horizon=2, dynamics_width=32),
    fit=FitConfig(steps=150, batch_size=64, learning_rate=3e-3, log_every=25),
)
FIT = FitConfig(steps=200, batch_size=64, learning_rate=3e-3, log_every=25)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return recorded()


@pytest.fixture(scope="module")
def context() -> torch.Tensor:
    return torch.zeros(EPISODES, 0)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("training")


@pytest.fixture(scope="module")
def encoder(dataset: Dataset, context: torch.Tensor, work: Path) -> Trained:
    return train_encoder(dataset, context, ENCODER, setting(work / "encoder"))


@pytest.fixture(scope="module")
def data(dataset: Dataset, context: torch.Tensor, work: Path, encoder: Trained) -> LatentData:
    assert isinstance(encoder.module, Representation)
    return encode(dataset, context, encoder.module.encoder, setting(work / "encoder"))


@pytest.fixture(scope="module")
def ensemble(data: LatentData, work: Path) -> Trained:
    stage = EnsembleSection(net=EnsembleConfig(members=3, width=32, support_size=200), fit=FIT)
    return train_ensemble(data, stage, setting(work / "ensemble"))


@pytest.fixture(scope="module")
def density(data: LatentData, work: Path) -> Trained:
    stage = DensitySection(net=DensityConfig(width=32, noise_ratio=4), fit=FIT)
    return train_density(data, stage, setting(work / "density"))


@pytest.fixture(scope="module")
def policy(data: LatentData, ensemble: Trained, work: Path) -> Trained:
    assert isinstance(ensemble.module, SupportedDynamics)
    stage = PolicySection(net=PolicyConfig(width=32), fit=FIT)
    return train_policy(data, ensemble.module.ensemble, stage, setting(work / "policy"))


def fell(trained: Trained, name: str, factor: float) -> bool:
    """Whether a held-out metric ended below `factor` times its first value."""
    return trained.curve[-1][name] < factor * trained.curve[0][name]


def held_out(data: LatentData) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    return data.transitions(data.val)


# ---- windows ------------------------------------------------------------------------------------


def test_stacks_are_the_last_frames_and_never_cross_an_episode(dataset: Dataset) -> None:
    numbered = torch.arange(len(dataset.pixels))[:, None, None, None]
    windows = FrameWindows(dataset, HeldFrames(numbered), torch.zeros(EPISODES, 0))
    rows = np.array([0, 1, 5, ROWS, ROWS + 1])
    found = windows.stacks(rows).flatten(1).tolist()
    assert found == [
        [0, 0, 0],
        [0, 0, 1],
        [3, 4, 5],
        [ROWS, ROWS, ROWS],
        [ROWS, ROWS, ROWS + 1],
    ]


def test_a_still_stack_repeats_its_own_frame(dataset: Dataset) -> None:
    numbered = torch.arange(len(dataset.pixels))[:, None, None, None]
    windows = FrameWindows(dataset, HeldFrames(numbered), torch.zeros(EPISODES, 0))
    found = windows.stacks(np.array([[5, 9]]), np.array([[True, False]])).flatten(2).tolist()
    assert found == [[[5, 5, 5], [7, 8, 9]]]


def test_a_window_holds_states_the_actions_between_them_and_its_context(dataset: Dataset) -> None:
    numbered = torch.arange(len(dataset.pixels))[:, None, None, None]
    windows = FrameWindows(dataset, HeldFrames(numbered), torch.arange(EPISODES)[:, None].float())
    stacks, actions, context = windows.window(np.array([2, ROWS + 3]), 2)
    assert stacks[..., -1, 0, 0, 0].tolist() == [[2, 3, 4], [ROWS + 3, ROWS + 4, ROWS + 5]]
    np.testing.assert_array_equal(actions[1], dataset.action[ROWS + 3 : ROWS + 5])
    assert context.tolist() == [[0], [1]]


def test_training_and_held_out_transitions_never_share_an_episode(data: LatentData) -> None:
    train, val = data.train.numpy(), data.val.numpy()
    assert not set(train // ROWS) & set(val // ROWS)
    assert len(train) + len(val) == EPISODES * (ROWS - 1)
    for rows in (train, val):
        assert (rows // ROWS == (rows + 1) // ROWS).all()
        assert torch.isfinite(data.action[rows]).all()


def test_windows_start_anywhere() -> None:
    rows = np.arange(0, 60, 2)
    found = Starts(rows).batch(np.random.default_rng(0), 50)
    np.testing.assert_array_equal(found, rows[np.random.default_rng(0).integers(30, size=50)])


def test_the_context_image_of_an_episode_comes_off_its_frames(
    dataset: Dataset, tmp_path: Path
) -> None:
    images = np.random.default_rng(0).integers(256, size=(EPISODES, 64, 64, 3), dtype=np.uint8)
    phi = Encoder(EncoderConfig(pool=8))
    rows, work = np.arange(EPISODES * ROWS), setting(tmp_path)
    plain = frame_features(dataset, phi, work).take(rows)
    less = frame_features(replace(dataset, context=images), phi, work).take(rows)
    taken = (plain - less).unflatten(0, (EPISODES, ROWS))
    expected = phi.preprocess(torch.from_numpy(images))[:, None].expand_as(taken)
    torch.testing.assert_close(taken, expected, rtol=0, atol=0.25)  # of half precision


def test_an_encoder_takes_contexts(dataset: Dataset, tmp_path: Path) -> None:
    stage = ENCODER.model_copy(update={"fit": FitConfig(steps=10, batch_size=64)})
    context = torch.randn(EPISODES, 5, generator=torch.Generator().manual_seed(0))
    trained = train_encoder(dataset, context, stage, setting(tmp_path))
    assert isinstance(trained.spec, EncoderSpec)
    assert trained.spec.sizes.context == 5
    assert isinstance(trained.module, Representation)
    data = encode(dataset, context, trained.module.encoder, setting(tmp_path))
    torch.testing.assert_close(data.context[::ROWS], context)
    assert data.sizes == trained.spec.sizes


# ---- encoder ------------------------------------------------------------------------------------


def test_the_encoders_losses_fall_and_its_latents_hold_the_state(encoder: Trained) -> None:
    assert fell(encoder, "val_info_nce", 0.8)
    assert encoder.metrics["probe_knn_r2"] > 0.8
    assert 1.5 < encoder.metrics["latent_dimensions_used"] <= 3
    assert isinstance(encoder.spec, EncoderSpec)
    assert encoder.spec.sizes.model_dump() == {"latent": 3, "action": 2, "context": 0, "state": 2}


def test_distances_of_images_are_trained_on_and_are_the_same_every_time(
    dataset: Dataset, tmp_path: Path
) -> None:
    short, none = FitConfig(steps=10, batch_size=64), torch.zeros(EPISODES, 0)
    weights = []
    for part, weight in (("a", 1.0), ("b", 1.0), ("c", 0.0)):
        cpc = ENCODER.cpc.model_copy(update={"isometry_weight": weight})
        stage = ENCODER.model_copy(update={"fit": short, "cpc": cpc})
        trained = train_encoder(dataset, none, stage, setting(tmp_path / part))
        weights.append(torch.cat([p.flatten() for p in trained.module.parameters()]))
        assert ("train_isometry" in trained.curve[-1]) == (weight > 0)
    torch.testing.assert_close(weights[0], weights[1], rtol=0, atol=0)
    assert not torch.equal(weights[0], weights[2])


def test_the_encoders_scale_and_step_lengths_are_those_of_its_latents(
    encoder: Trained, data: LatentData
) -> None:
    model = encoder.module
    assert isinstance(model, Representation)
    z, _, _, z_next = data.transitions(data.train)
    torch.testing.assert_close(model.scale.mean, z.mean(0))
    torch.testing.assert_close(model.scale.step, (z_next - z).square().mean(0).sqrt())
    lengths = (z_next - z).norm(dim=1).numpy()
    for p in (0.05, 0.5, 0.95):
        assert model.step_length(p) == pytest.approx(np.quantile(lengths, p), rel=1e-3)


def test_encoding_is_the_encoder_on_every_rows_stack(
    dataset: Dataset, encoder: Trained, data: LatentData
) -> None:
    model = encoder.module
    assert isinstance(model, Representation)
    rows = np.array([0, 1, ROWS - 1, ROWS, 100])
    features = model.encoder.preprocess(torch.from_numpy(dataset.pixels[:]))
    windows = FrameWindows(dataset, HeldFrames(features), torch.zeros(30, 0))
    with torch.no_grad():
        expected = model.encoder(windows.stacks(rows))
    torch.testing.assert_close(data.z[rows], expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(data.state, dataset.state)


# ---- the others ---------------------------------------------------------------------------------


def test_the_ensemble_learns_and_calibrates_its_variance(
    ensemble: Trained, data: LatentData
) -> None:
    assert fell(ensemble, "val_mse", 0.7)
    assert isinstance(ensemble.module, SupportedDynamics)
    z, action, context, _ = held_out(data)
    with torch.no_grad():
        _, variance = ensemble.module.ensemble(z, action, context)
    table = ensemble.module.ensemble.variance_quantiles
    for p in (0.1, 0.5, 0.99):
        assert table.at(p) == pytest.approx(np.quantile(variance.numpy(), p), rel=1e-3)


def test_the_ensembles_members_differ(ensemble: Trained, data: LatentData) -> None:
    assert isinstance(ensemble.module, SupportedDynamics)
    z, action, context, _ = held_out(data)
    with torch.no_grad():
        steps = ensemble.module.ensemble.members(z, action, context)
    assert (steps[0] - steps[1]).abs().mean() > 1e-3


def test_the_support_holds_training_states_and_is_calibrated_on_predictions(
    ensemble: Trained, data: LatentData
) -> None:
    assert isinstance(ensemble.module, SupportedDynamics)
    support = ensemble.module.support
    rows = support.rows
    assert len(set(rows.tolist())) == 200
    assert set(rows.tolist()) <= set(data.train.tolist())
    torch.testing.assert_close(support.latents, data.z[rows])
    torch.testing.assert_close(support.states, data.state[rows])
    z, action, context, _ = held_out(data)
    with torch.no_grad():
        predicted, _ = ensemble.module.ensemble(z, action, context)
    gap = (predicted[:, None] - support.latents).norm(dim=2).amin(1)
    for p in (0.5, 0.99):
        expected = np.quantile(gap.numpy(), p)
        assert support.distance_quantiles.at(p) == pytest.approx(expected, rel=1e-2)


def test_the_support_is_never_larger_than_the_data(data: LatentData, tmp_path: Path) -> None:
    stage = EnsembleSection(
        net=EnsembleConfig(members=1, width=8), fit=FitConfig(steps=1, batch_size=4)
    )
    trained = train_ensemble(data, stage, setting(tmp_path))
    assert isinstance(trained.module, SupportedDynamics)
    assert len(trained.module.support.latents) == len(data.train)
    assert trained.module.config.support_size == len(data.train)


def test_the_density_tells_steps_from_noise_and_calibrates_its_threshold(
    density: Trained, data: LatentData
) -> None:
    assert fell(density, "val_nce", 0.95)
    assert density.metrics["val_balanced_accuracy"] > 0.6
    assert isinstance(density.module, TransitionDensity)
    z, _, context, z_next = held_out(data)
    with torch.no_grad():
        log_density = density.module(z, z_next, context)
        far = density.module(z, z + 10 * (z_next - z), context)
    table = density.module.log_density_quantiles
    for p in (0.02, 0.5):
        expected = np.quantile(log_density.numpy(), p)
        assert table.at(p) == pytest.approx(expected, rel=1e-3, abs=1e-3)
    assert (far < table.at(0.02)).float().mean() > 0.9


def test_noise_from_other_contexts_needs_contexts_and_the_ensemble(
    data: LatentData, tmp_path: Path
) -> None:
    fit = FitConfig(steps=5, batch_size=16)
    dynamics = DynamicsEnsemble(EnsembleConfig(members=2, width=8), 3, 2, 2)
    differing = replace(data, context=torch.rand(len(data.z), 2))

    def weights(data: LatentData, share: float, dynamics: DynamicsEnsemble | None) -> Tensor:
        stage = DensitySection(net=DensityConfig(width=8, context_share=share), fit=fit)
        work = setting(tmp_path / f"{len(data.context.T)} {share}")
        weight: Tensor = train_density(data, stage, work, dynamics).module.get_parameter(
            "first.weight"
        )
        return weight

    assert torch.equal(weights(data, 0.0, None), weights(data, 0.5, None))
    assert not torch.equal(weights(differing, 0.0, None), weights(differing, 0.5, dynamics))
    with pytest.raises(ValueError, match="needs the ensemble"):
        weights(differing, 0.5, None)


def test_relabelled_transitions_are_data_in_the_contexts_of_the_rows_that_they_stand_for(
    data: LatentData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = replace(data, context=torch.rand(len(data.z), 2))
    dynamics = DynamicsEnsemble(EnsembleConfig(members=2, width=8), 3, 2, 2)
    asked: list[Tensor] = []
    shares: list[float] = []
    seen: list[int] = []

    def relabelled(self: OtherContexts, rows: Tensor, share: float, rng: object) -> Tensor:
        asked.append(rows)
        shares.append(share)
        return rows.flip(0)

    def log_ratio(self: TransitionDensity, z: Tensor, z_next: Tensor, context: Tensor) -> Tensor:
        rows = asked[-1]
        places, count = rows.flip(0), len(rows)
        if len(z) == 11 * count:  # with ten false ones each; not in calibration
            assert torch.equal(z[:count], data.z[places])
            assert torch.equal(z_next[:count], data.z[places + 1])
            assert torch.equal(context, data.context[rows].repeat(11, 1))
            assert torch.equal(z[6 * count : 7 * count], data.z[places])  # the first one elsewhere
            seen.append(count)
        return known(self, z, z_next, context)

    known = TransitionDensity.log_ratio
    with monkeypatch.context() as patch:
        patch.setattr(OtherContexts, "relabelled", relabelled)
        patch.setattr(TransitionDensity, "log_ratio", log_ratio)
        net = DensityConfig(width=8, relabelled_share=0.25)
        stage = DensitySection(net=net, fit=FitConfig(steps=3, batch_size=16))
        train_density(data, stage, setting(tmp_path), dynamics)
    assert shares.count(0.25) == 3
    assert len(seen) == len(shares)
    assert set(shares) == {0.0, 0.25}  # what is held out is never relabelled


def test_the_policy_learns_and_calibrates_its_round_trip(
    policy: Trained, ensemble: Trained, data: LatentData
) -> None:
    assert fell(policy, "val_mse", 0.8)
    assert isinstance(policy.module, LocalPolicy)
    assert isinstance(ensemble.module, SupportedDynamics)
    z, _, context, z_next = held_out(data)
    with torch.no_grad():
        action = policy.module(z, z_next, context)
        landed, _ = ensemble.module.ensemble(z, action, context)
    miss = (landed - z_next).norm(dim=1).numpy()
    table = policy.module.round_trip_quantiles
    for p in (0.5, 0.95):
        assert table.at(p) == pytest.approx(np.quantile(miss, p), rel=1e-3)


def test_the_same_seed_trains_the_same_weights_and_another_seed_others(
    data: LatentData, tmp_path: Path
) -> None:
    stage = DensitySection(net=DensityConfig(width=8), fit=FitConfig(steps=5, batch_size=16))

    def weights(name: str, seed: int) -> dict[str, Any]:
        return train_density(data, stage, setting(tmp_path / name, seed)).module.state_dict()

    one, again, other = weights("one", 3), weights("again", 3), weights("other", 4)
    assert all(torch.equal(one[name], again[name]) for name in one)
    assert not torch.equal(one["first.weight"], other["first.weight"])


def test_episodes_shorter_than_the_horizon_are_named(tmp_path: Path) -> None:
    short = recorded(rows=2, episodes=5)
    with pytest.raises(DataError, match="horizon"):
        train_encoder(short, torch.zeros(5, 0), ENCODER, setting(tmp_path))


@pytest.mark.parametrize("stage", ["encoder", "ensemble", "density", "policy"])
def test_every_stage_trains_in_bfloat16_to_about_the_same(
    stage: str,
    dataset: Dataset,
    context: torch.Tensor,
    data: LatentData,
    ensemble: Trained,
    tmp_path: Path,
) -> None:
    dynamics = ensemble.module
    assert isinstance(dynamics, SupportedDynamics)

    def last_loss(precision: str) -> float:
        short = FitConfig.model_validate(
            {"steps": 30, "batch_size": 64, "learning_rate": 3e-3, "precision": precision}
        )
        here = setting(tmp_path / precision)
        if stage == "encoder":
            update = {"isometry_weight": 1.0, "lookalikes": 4}
            cpc = ENCODER.cpc.model_copy(update=update)
            fit = {"cpc": cpc, "fit": short}
            trained = train_encoder(dataset, context, ENCODER.model_copy(update=fit), here)
        elif stage == "ensemble":
            net = EnsembleConfig(members=2, width=32, support_size=200)
            trained = train_ensemble(data, EnsembleSection(net=net, fit=short), here)
        elif stage == "density":
            net_of_psi = DensityConfig(width=32, noise_ratio=4)
            trained = train_density(data, DensitySection(net=net_of_psi, fit=short), here)
        else:
            net_of_pi = PolicyConfig(width=32)
            policy = PolicySection(net=net_of_pi, fit=short)
            trained = train_policy(data, dynamics.ensemble, policy, here)
        weights = list(trained.module.parameters())
        assert {p.dtype for p in weights} == {torch.float32}
        return trained.curve[-1]["train_loss"]

    exact, rough = last_loss("float32"), last_loss("bfloat16")
    assert rough == pytest.approx(exact, rel=0.1)
    assert rough != exact
