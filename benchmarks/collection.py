"""`elast collect` by W workers against W times the bare environment loop of one process.

A worker spends 20 to 30 microseconds on a frame to compress and check it, and a command at least
1.4 s until its workers have imported their libraries. Where the bare loop takes 60 microseconds a
frame, as that of block-s does, 0.65 is the most that any number of frames can reach, and 0.4 is
what 50,000 of them can.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

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
    length = load("quick", env).collect.episode_steps
    bare = [bare_loop(env)]
    alone = _collect(env, length, bench.workers)
    whole = _collect(env, n, bench.workers)
    bare.append(bare_loop(env))
    frames = n + -(-n // length)
    rate, fastest = frames / whole.wall, 1 / min(loop.wall for loop in bare)
    return Figure(
        measurement="collection",
        name=f"{env}, {n:,} transitions, {bench.workers} workers",
        ratio=rate / (bench.workers * fastest),
        at_least=LEAST,
        seconds={
            "collect": whole.wall,
            "CPU of all its processes": whole.cpu,
            "CPU of so many frames in the bare loop": frames * min(loop.cpu for loop in bare),
            "collect one episode": alone.wall,
            "its CPU": alone.cpu,
        },
        facts={"frames/s": rate, "bare loop, frames/s a process": fastest},
    )


class Spent(NamedTuple):
    """Seconds on the clock, and of all processors."""

    wall: float
    cpu: float


def bare_loop(name: str, seconds: float = BARE_SECONDS) -> Spent:
    """Seconds a frame of `advance` and `frame` under uniformly random actions, in this process."""
    config = load("quick", name)
    env, rng = make(name, config.env), np.random.default_rng(0)
    length, frames = config.collect.episode_steps, 0
    began, used = time.perf_counter(), time.process_time()
    while time.perf_counter() - began < seconds:
        env.set_state(*env.sample_start(rng))
        env.frame()
        for action in rng.uniform(-1, 1, (length, env.action_size)).astype(np.float32):
            env.advance(action)
            env.frame()
        frames += length + 1
    return Spent((time.perf_counter() - began) / frames, (time.process_time() - used) / frames)


def _collect(env: str, n: int, workers: int) -> Spent:
    """Seconds of the command, in a new home."""
    words = ["collect", "--env", env, "--preset", "quick", "--n", str(n)]
    command = [sys.executable, "-m", "elast_cli", *words, "--workers", str(workers), "--quiet"]
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "ELAST_HOME": home}
        before = os.times()
        subprocess.run(command, env=environment, cwd=Path(home), stdout=subprocess.PIPE, check=True)
        after = os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return Spent(after.elapsed - before.elapsed, used)
