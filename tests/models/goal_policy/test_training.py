"""Every goal-conditioned policy is trained repeatably, and goes on where it was killed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from elast_cli.models.goal_policy.config import GoalNetConfig
from elast_cli.models.goal_policy.gcbc.config import GcbcSection
from elast_cli.models.goal_policy.gcbc.training import train_gcbc
from elast_cli.models.goal_policy.gcidm.config import GcidmConfig, GcidmSection
from elast_cli.models.goal_policy.gcidm.training import train_gcidm
from elast_cli.models.goal_policy.gciql.config import GciqlSection, IqlConfig
from elast_cli.models.goal_policy.gciql.training import train_gciql
from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.models.goal_policy.pixel_gcbc.config import PixelGcbcConfig, PixelGcbcSection
from elast_cli.models.goal_policy.pixel_gcbc.training import train as train_on_pixels
from elast_cli.models.inputs import Inputs
from elast_cli.models.part import FitConfig, Setting, Trained
from tests.toys.goals import goal_data, moving_square, setting

FIT = FitConfig(steps=7, batch_size=8, log_every=100, save_every=2)
SMALL = GoalNetConfig(width=8, depth=1)
Train = Callable[[Setting], Trained]


class Killed(BaseException):
    """Stands for a process that ends here."""


def on_latents(train: Callable[[Any, Any, Setting], Trained], section: Any) -> Train:
    rng = np.random.default_rng(0)
    data = goal_data(rng.standard_normal((12, 6, 3)), rng.uniform(-1, 1, (12, 6, 2)))
    return lambda place: train(data, section, place)


def on_pixels(place: Setting) -> Trained:
    section = PixelGcbcSection(net=PixelGcbcConfig(width=8, depth=1, pool=4, channels=4), fit=FIT)
    return train_on_pixels(Inputs(moving_square(12, 4), {}, place), section, place)


TRAIN: dict[str, Train] = {
    "gcbc": on_latents(train_gcbc, GcbcSection(net=SMALL, fit=FIT)),
    "gcidm": on_latents(train_gcidm, GcidmSection(net=GcidmConfig(width=8, depth=1), fit=FIT)),
    "gciql": on_latents(
        train_gciql,
        GciqlSection(net=SMALL, critic=SMALL, iql=IqlConfig(target_rate=0.3), fit=FIT),
    ),
    "pixel_gcbc": on_pixels,
}


def assert_same(one: Trained, other: Trained) -> None:
    """Equal to the bit."""
    assert one.spec == other.spec
    assert one.curve == other.curve
    theirs = other.module.state_dict()
    for name, tensor in one.module.state_dict().items():
        assert torch.equal(tensor, theirs[name]), name


@pytest.mark.parametrize("kind", TRAIN)
def test_a_killed_training_ends_as_one_that_was_not(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = TRAIN[kind](setting(tmp_path / "whole"))
    future, drawn = Hindsight.future, 0

    def until_killed(*words: Any, **named: Any) -> Any:
        nonlocal drawn
        drawn += 1
        if drawn == 6:  # the last checkpoint is of step 4
            raise Killed
        return future(*words, **named)

    with monkeypatch.context() as patch:
        patch.setattr(Hindsight, "future", until_killed)
        with pytest.raises(Killed):
            TRAIN[kind](setting(tmp_path / "broken"))
    assert_same(TRAIN[kind](setting(tmp_path / "broken")), whole)


@pytest.mark.parametrize("kind", TRAIN)
def test_another_seed_gives_another_policy(kind: str, tmp_path: Path) -> None:
    one, other = (TRAIN[kind](setting(tmp_path / str(seed), seed)) for seed in (0, 1))
    last = [*one.module.state_dict()][-1]
    assert not torch.equal(one.module.state_dict()[last], other.module.state_dict()[last])


@pytest.mark.parametrize("kind", TRAIN)
def test_what_is_stored_names_every_tensor(kind: str, tmp_path: Path) -> None:
    trained = TRAIN[kind](setting(tmp_path))
    spec: Any = trained.spec
    state = trained.module.state_dict()
    assert {name: want.shape for name, want in spec.tensors().items()} == {
        name: tuple(tensor.shape) for name, tensor in state.items()
    }
    assert spec.build().state_dict().keys() == state.keys()
    assert {"val_mse"} <= trained.metrics.keys()
    assert not trained.module.training
