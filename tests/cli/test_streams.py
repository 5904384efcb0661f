"""Standard streams that are closed, and a working directory that is gone."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from elast_cli.store.store import Store
from tests.toys.command_line import COLLECT, ELAST


def closed(
    numbers: list[int], arguments: list[str], home: Path
) -> subprocess.CompletedProcess[str]:
    """A command line whose streams of these numbers are closed, as by `>&-` in a shell."""
    closing = " ".join(f"{number}>&-" for number in numbers)
    run = ["sh", "-c", f'exec "$@" {closing}', "sh", *ELAST, *arguments]
    return subprocess.run(run, cwd=home, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("numbers", [[0], [1], [2], [0, 1, 2]])
def test_a_closed_stream_changes_no_result(numbers: list[int], home: Path) -> None:
    done = closed(numbers, [word for word in COLLECT if word != "--quiet"], home)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ("" if 1 in numbers else "block-s/dataset/v1\n")
    assert "Traceback" not in done.stderr
    (ref,) = Store(home).refs()
    Store(home).verify(ref)


@pytest.mark.parametrize("arguments", [["ls"], ["--help"], ["--version"], ["ls", "--json"]])
def test_what_prints_only_passes_without_stdout(arguments: list[str], home: Path) -> None:
    done = closed([1], arguments, home)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_working_directory_that_is_gone_is_one_line(home: Path) -> None:
    (home / "gone").mkdir()
    run = ["sh", "-c", 'rmdir ../gone; exec "$@"', "sh", *ELAST, *COLLECT]
    environment = {**os.environ, "ELAST_HOME": str(home)}
    done = subprocess.run(
        run, cwd=home / "gone", env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 74
    assert done.stderr == "elast: the working directory was removed; run: cd\n"
