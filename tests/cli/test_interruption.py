"""Signals, killed parents, and two processes that make the same artifact."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from elast_cli.store.store import Store
from tests.toys.command_line import ELAST, fails


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_cleanly_and_the_same_command_continues(
    number: signal.Signals, code: int, home: Path
) -> None:
    arguments = ["collect", "--env", "block-s", "--n", "60000", "--workers", "2", "--quiet"]
    process = subprocess.Popen(
        [*ELAST, *arguments],
        cwd=home,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # a shell's background ignores it
    )
    runs = home / "data/.runs"
    deadline = time.monotonic() + 60
    while len(list(runs.glob("*/*.h5"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == code
    assert err == ("elast: interrupted; the same command continues\n" if code == 130 else "")
    shards = len(list(runs.glob("*/*.h5")))
    assert shards >= 3
    time.sleep(1)
    assert len(list(runs.glob("*/*.h5"))) == shards  # no worker outlived it
    assert list((home / "data/.staging").glob("*")) == []
    assert Store(home).refs() == []


def test_workers_die_with_a_killed_parent(home: Path) -> None:
    arguments = ["collect", "--env", "block-s", "--n", "60000", "--workers", "2", "--quiet"]
    process = subprocess.Popen([*ELAST, *arguments], cwd=home)
    runs = home / "data/.runs"
    deadline = time.monotonic() + 60
    while len(list(runs.glob("*/*.h5"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait(timeout=30)
    time.sleep(1)
    shards = len(list(runs.glob("*/*.h5")))
    time.sleep(1)
    assert len(list(runs.glob("*/*.h5"))) == shards


def test_no_wait_exits_75_while_another_process_makes_the_same(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["collect", "--env", "block-s", "--n", "60000", "--workers", "1", "--quiet"]
    process = subprocess.Popen([*ELAST, *arguments], cwd=home)
    try:
        deadline = time.monotonic() + 60
        while not list((home / "data/.runs").glob("*/*.h5")) and time.monotonic() < deadline:
            time.sleep(0.05)
        fails(capsys, 75, [*arguments, "--no-wait"], "another process", "--no-wait")
    finally:
        process.kill()
        process.wait()
