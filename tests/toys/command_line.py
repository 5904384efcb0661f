"""Command lines, and those that must fail."""

from __future__ import annotations

import sys

import pytest

from elast_cli.cli import app as cli

ELAST = [sys.executable, "-m", "elast_cli"]
COLLECT = ["collect", "--env", "block-s", "--n", "100", "--workers", "1", "--quiet"]

# the least with which a chain of `quick` runs
TINY = [
    "collect.n=600",
    "collect.episode_steps=20",
    "encoder.fit.steps=10",
    "ensemble.fit.steps=5",
    "ensemble.net.support_size=200",
    "density.fit.steps=5",
    "policy.fit.steps=5",
    "planner.expansions=30",
]


def fails(capsys: pytest.CaptureFixture[str], code: int, arguments: list[str], *words: str) -> str:
    """Run a command line that must fail with one line on stderr that has these words."""
    assert cli.run(arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, lines
    assert all(word in lines[0] for word in words), lines[0]
    return lines[0]
