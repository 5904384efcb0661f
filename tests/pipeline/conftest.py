"""Homes in which everything ran once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.toys.pipeline import PARAM, RUN, run_in


@pytest.fixture(scope="package")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which everything ran with one worker."""
    home = tmp_path_factory.mktemp("one")
    assert run_in(home, [*RUN, "--workers", "1"]) == 0
    return home


@pytest.fixture(scope="package")
def with_context(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home in which everything ran in an environment with contexts."""
    home = tmp_path_factory.mktemp("param")
    words = ["run", *PARAM, "--episodes", "2", "--quiet", "--workers", "1"]
    assert run_in(home, words) == 0
    return home
