"""What every test shares: one thread a library, and a home of its own."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before any library reads it

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.toys.tables import kept_tables

for _name in [name for name in os.environ if name.startswith("GIT_")]:
    del os.environ[_name]  # a git hook's: tests make repositories of their own

# The same examples in every run, so that a red test is red again. HYPOTHESIS_PROFILE=search looks
# for new ones, and prints a seed to keep as an @example.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(scope="session", autouse=True)
def nothing_is_written_into_the_checkout(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[None]:
    """A temporary $ELAST_HOME for tests that name none."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ELAST_HOME", str(tmp_path_factory.mktemp("elast-home")))
        yield


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty $ELAST_HOME that is the working directory too."""
    monkeypatch.setenv("ELAST_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def tables() -> Iterator[None]:
    """The tables of parts and of methods, afterwards as they were."""
    with kept_tables():
        yield
