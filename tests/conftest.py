"""What every test shares: one thread a library, and a home of its own."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before any library reads it

from pathlib import Path

import pytest


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty $ELAST_HOME that is the working directory too."""
    monkeypatch.setenv("ELAST_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path
