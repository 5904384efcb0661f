"""A stage that collects two episodes, and processes that are killed within it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from elast_cli.data.dataset import Episode
from elast_cli.data.shards import compact, shard_path, write_shard
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.artifacts import recipe

EPISODES = 2


def episode(index: int) -> Episode:
    """Six random frames."""
    rng = np.random.default_rng(index)
    action = rng.uniform(-1, 1, (6, 2)).astype(np.float32)
    action[-1] = np.nan
    return Episode(
        pixels=rng.integers(0, 256, (6, 64, 64, 3), np.uint8),
        action=action,
        state=rng.normal(size=(6, 2)).astype(np.float32),
        context=None,
        seed_index=index,
    )


def collect(store: Store) -> tuple[Ref, list[int]]:
    """A stage as stages are written; also returns the episodes that it had to make."""
    made: list[int] = []
    with store.begin(recipe(), parents={}) as run:
        if run.published:
            return run.published, made
        shards = [shard_path(run.work, index) for index in range(EPISODES)]
        for index, path in enumerate(shards):
            if not path.exists():
                write_shard(path, [episode(index)])
                made.append(index)
        compact(shards, run.staging / "episodes.h5", attrs={"env": "block-s"})
        return run.publish({"episodes": EPISODES}), made


def collect_killed_at_every_point(home: Path) -> int:
    """Run `collect` in one child after another, the k-th killed at its k-th point: how many."""
    for point in range(1000):
        child = os.fork()
        if child == 0:
            kill_at(point)
            collect(Store(home / str(point)))
            os._exit(0)
        if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != -signal.SIGKILL:
            return point
    raise AssertionError("no child reached its end")


def kill_at(point: int) -> None:
    """Kill this process at its `point`-th moment just before or after a change on disk."""
    passed = 0

    def tick() -> None:
        nonlocal passed
        if passed == point:
            os.kill(os.getpid(), signal.SIGKILL)
        passed += 1

    def wrap(owner: Any, name: str) -> None:
        original = getattr(owner, name)

        def wrapped(*args: Any, **options: Any) -> Any:
            tick()
            result = original(*args, **options)
            tick()
            return result

        setattr(owner, name, wrapped)

    for owner, name in (
        (os, "fsync"),
        (os, "rename"),
        (os, "replace"),
        (os, "unlink"),
        (os, "mkdir"),
    ):
        wrap(owner, name)


def python(script: str) -> str:
    """What a script prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()
