"""What is killed, interrupted or runs out of disk ends the same."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from elast_cli.engine.local import LocalEngine
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import ENV, SETS, episodes, run_in, weights


def test_a_training_killed_twice_ends_with_the_same_weights(one: Path, tmp_path: Path) -> None:
    shutil.copytree(one / "data", tmp_path / "data")
    command = [sys.executable, "-m", "elast_cli", "train-encoder", *ENV, *SETS, "--quiet"]
    environment = {**os.environ, "ELAST_HOME": str(tmp_path)}
    runs = tmp_path / "artifacts/.runs"
    newest = 0.0
    for _ in range(2):
        process = subprocess.Popen(command, env=environment)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            stamps = [path.stat().st_mtime for path in runs.glob("*/checkpoint.pt")]
            if stamps and stamps[0] > newest:
                newest = stamps[0]
                break
            time.sleep(0.002)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert Store(tmp_path).refs("block-s", "encoder") == []
    arguments = ["train-encoder", *ENV, *SETS, "--quiet"]
    assert run_in(tmp_path, arguments) == 0
    store = Store(tmp_path)
    found = store.manifest(Ref("block-s", "encoder", 1)).files["model.safetensors"].sha256
    assert found == weights(one)["encoder"]


def test_an_interrupted_or_damaged_evaluation_continues_and_ends_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["eval", *ENV, "--methods", "random", "--level", "medium", "--episodes", "6"]
    words += ["--num-envs", "2", "--workers", "1"]
    assert run_in(tmp_path / "whole", [*words, "--quiet"]) == 0

    def interrupted(_engine: LocalEngine, task: Any, items: Any) -> Any:
        yield task(items[0])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(LocalEngine, "each", interrupted)
        assert run_in(tmp_path / "cut", words) == 130
    assert Store(tmp_path / "cut").refs() == []
    done = sorted((tmp_path / "cut/artifacts/.runs").glob("*/medium-*.json"))
    assert len(done) == 2
    done[0].write_bytes(done[0].read_bytes()[:10])
    for frames in done[0].parent.glob("*.npz"):
        frames.write_bytes(b"")
    assert run_in(tmp_path / "cut", [*words, "--quiet"]) == 0
    assert episodes(tmp_path / "cut") == episodes(tmp_path / "whole")


@pytest.mark.parametrize("where", ["encoder.fit.save_every=5", "encoder.fit.save_every=5000"])
def test_a_full_disk_ends_a_training_with_one_line_and_leaves_nothing_half_written(
    one: Path, tmp_path: Path, where: str
) -> None:
    shutil.copytree(one / "data", tmp_path / "data")
    words = ["train-encoder", *ENV, *SETS, "--set", where, "--quiet"]
    limited = f'ulimit -f 256; exec "{sys.executable}" -m elast_cli "$@"'  # kB a file
    done = subprocess.run(
        ["bash", "-c", limited, "bash", *words],
        env={**os.environ, "ELAST_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 74, done.stderr
    assert done.stderr.startswith("elast: storage failed:")
    assert len(done.stderr.splitlines()) == 1
    assert Store(tmp_path).refs("block-s", "encoder") == []
    assert not list((tmp_path / "artifacts/.staging").glob("*"))
    assert not list((tmp_path / "artifacts/.runs").glob("*/checkpoint*"))
