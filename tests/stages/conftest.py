"""Jobs in an environment without contexts and in one with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from elast_cli.stages import presets
from elast_cli.stages.job import Job
from elast_cli.store.store import Store
from tests.toys.lineages import ENV, PARAM


@pytest.fixture
def job(home: Path) -> Job:
    """A job in an environment without contexts."""
    config = presets.load("quick", ENV, ["collect.n=60", "collect.episode_steps=10"])
    return Job(store=Store(home), env=ENV, preset="quick", config=config)


@pytest.fixture
def param_job(job: Job) -> Job:
    """A job in an environment whose obstacles change with the episode."""
    return replace(job, env=PARAM, config=presets.load("quick", PARAM))
