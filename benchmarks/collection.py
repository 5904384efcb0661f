"""`elast collect` by W workers against W times the bare environment loop of one process.

The bare loop starts episodes, advances and draws frames under the actions of a collection, drawn
beforehand. What collection adds to a frame, whatever the task: its action, the copies of frame and
state, compression and checksum, 8 to 12 microseconds in all; and to a command the time until its
workers have imported their libraries, and putting the shards together.
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
from elast_cli.control.collection import CollectConfig
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.registry import make_simulated
from elast_cli.stages.presets import load

PRESET = "standard"
BARE_SECONDS = 2.0
EPISODES = 30
LEAST = 0.8


def figures(bench: Bench) -> list[Figure]:
    """Frames a second of whole commands, and of the last nine tenths of their frames."""
    return [
        figure
        for env, n in bench.sizes.collect.items()
        for figure in _figures(env, n, bench.workers)
    ]


def _figures(env: str, n: int, workers: int) -> tuple[Figure, Figure]:
    length = load(PRESET, env).section("collect", CollectConfig).episode_steps
    bare = [bare_loop(env)]
    first = max(n // 10, length)
    tenth = _collect(env, first, workers)
    whole = _collect(env, n, workers)
    bare.append(bare_loop(env))
    frames, fastest = _rows(n, length), 1 / min(loop.wall for loop in bare)
    rate = frames / whole.wall
    spent = max(whole.wall - tenth.wall, 1e-3)  # so little only where nearly all is start-up
    later = (frames - _rows(first, length)) / spent

    def figure(name: str, rate: float, seconds: dict[str, float]) -> Figure:
        return Figure(
            measurement="collection",
            name=name,
            ratio=rate / (workers * fastest),
            at_least=LEAST,
            seconds=seconds,
            facts={"frames/s": rate, "bare loop, frames/s a process": fastest},
        )

    return (
        figure(
            f"{env}, {n:,} transitions, {workers} workers",
            rate,
            {
                "collect": whole.wall,
                "CPU of all its processes": whole.cpu,
                "CPU of so many frames in the bare loop": frames * min(loop.cpu for loop in bare),
            },
        ),
        figure(f"{env}, all but the first {first:,}", later, {"the first": tenth.wall}),
    )


def _rows(n: int, length: int) -> int:
    """Frames of so many transitions in episodes of `length` steps."""
    return n + -(-n // length)


class Spent(NamedTuple):
    """Seconds on the clock, and of all processors."""

    wall: float
    cpu: float


def bare_loop(name: str, seconds: float = BARE_SECONDS) -> Spent:
    """Seconds a frame of `set_state`, `advance` and `frame` alone, in this process."""
    config = load(PRESET, name)
    env, rng = make_simulated(name, config.env), np.random.default_rng(0)
    collect = config.section("collect", CollectConfig)
    policy = RandomPolicy(env.action_size, collect.policy)
    length, frames = collect.episode_steps, 0
    episodes = []
    for _ in range(EPISODES):
        policy.reset(rng)
        episodes.append([policy.act(rng) for _ in range(length)])
    began, used = time.perf_counter(), time.process_time()
    while time.perf_counter() - began < seconds:
        for actions in episodes:
            env.set_state(*env.sample_start(rng))
            env.frame()
            for action in actions:
                env.advance(action)
                env.frame()
        frames += EPISODES * (length + 1)
    return Spent((time.perf_counter() - began) / frames, (time.process_time() - used) / frames)


def _collect(env: str, n: int, workers: int) -> Spent:
    """Seconds of the command, in a new home."""
    words = ["collect", "--env", env, "--preset", PRESET, "--n", str(n)]
    command = [sys.executable, "-m", "elast_cli", *words, "--workers", str(workers), "--quiet"]
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "ELAST_HOME": home}
        began, before = time.perf_counter(), os.times()
        subprocess.run(command, env=environment, cwd=Path(home), stdout=subprocess.PIPE, check=True)
        wall, after = time.perf_counter() - began, os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return Spent(wall, used)
