"""Untrained models of every environment, and its preset with small searches."""

from __future__ import annotations

from pathlib import Path

import pytest

from elast_cli.envs.registry import ENVS
from elast_cli.preset import Preset
from elast_cli.stages import presets
from tests.toys.methods import TINY, save_tiny


@pytest.fixture(scope="module", params=ENVS)
def env(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def folders(env: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return save_tiny(tmp_path_factory.mktemp(env), env)


@pytest.fixture(scope="module")
def tiny(env: str) -> Preset:
    return presets.load("quick", env, TINY)
