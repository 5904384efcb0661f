"""`elast collect` by W workers against W times the bare environment loop of one process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.document import Figure
from benchmarks.trained import Bench
from elast_cli.envs import make
from elast_cli.preset import load

BARE_SECONDS = 2.0
LEAST = 0.8


def figures(bench: Bench) -> list[Figure]:
    """Frames a second, start-up of the workers and writing of the dataset included."""
    return [_figure(bench, env, n) for env, n in bench.sizes.collect.items()]


def _figure(bench: Bench, env: str, n: int) -> Figure:
    bare = [bare_rate(env)]
    before = os.times()
    seconds = _collect(env, n, bench.workers)
    after = os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    bare.append(bare_rate(env))
    episodes = -(-n // load("quick", env).collect.episode_steps)
    rate = (n + episodes) / seconds
    return Figure(
        measurement="collection",
        name=f"{env}, {n:,} transitions, {bench.workers} workers",
        ratio=rate / (bench.workers * max(bare)),
        at_least=LEAST,
        seconds={"collect": seconds, "CPU of all its processes": used},
        facts={"frames/s": rate, "bare loop, frames/s a process": max(bare)},
    )


def bare_rate(name: str, seconds: float = BARE_SECONDS) -> float:
    """Frames a second of `advance` and `frame` under uniformly random actions, in this process."""
    config = load("quick", name)
    env, rng = make(name, config.env), np.random.default_rng(0)
    length, frames = config.collect.episode_steps, 0
    began = time.perf_counter()
    while (passed := time.perf_counter() - began) < seconds:
        env.set_state(*env.sample_start(rng))
        env.frame()
        for action in rng.uniform(-1, 1, (length, env.action_size)).astype(np.float32):
            env.advance(action)
            env.frame()
        frames += length + 1
    return frames / passed


def _collect(env: str, n: int, workers: int) -> float:
    """Wall seconds of the command, in a new home."""
    words = ["collect", "--env", env, "--preset", "quick", "--n", str(n)]
    command = [sys.executable, "-m", "elast_cli", *words, "--workers", str(workers), "--quiet"]
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "ELAST_HOME": home}
        began = time.perf_counter()
        subprocess.run(command, env=environment, cwd=Path(home), stdout=subprocess.PIPE, check=True)
        return time.perf_counter() - began
