"""`elast collect`: random interaction, one shard an episode, then one HDF5 file."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import elast_cli
from elast_cli.dataset import compact, shard_path, write_shard
from elast_cli.envs import RandomPolicy, RandomPolicyConfig, collect_episode, make, spec
from elast_cli.errors import DataError
from elast_cli.manifest import JsonDict
from elast_cli.publish import Run
from elast_cli.stages.job import Job, Step
from elast_cli.stages.workers import each

ALGORITHM_VERSION = 1
DATASET_FILE = "dataset.h5"
CHUNK = 20  # episodes a task of a worker


def step(job: Job) -> Step:
    """The dataset of a job."""
    config: JsonDict = {
        "collect": job.config.collect.model_dump(mode="json"),
        "env": job.config.env,
    }
    recipe = job.recipe("dataset", config, {}, algorithm_version=ALGORITHM_VERSION, by_torch=False)
    return Step(job, recipe, {}, lambda run: _collect(job, run))


@dataclass(frozen=True)
class _Chunk:
    """A few episodes for one worker."""

    env: str
    config: JsonDict
    policy: RandomPolicyConfig
    seed: int
    length: int
    episodes: tuple[int, ...]
    folder: Path


def _collect(job: Job, run: Run) -> JsonDict:
    began = time.monotonic()
    collect = job.config.collect
    shards = [shard_path(run.work, index) for index in range(collect.episodes)]
    missing = [index for index, path in enumerate(shards) if not path.exists()]
    if len(missing) < len(shards):
        job.progress.note(f"collect: {len(shards) - len(missing)} episodes are there already")
    chunks = [
        _Chunk(
            env=job.env,
            config=job.config.env,
            policy=collect.policy,
            seed=job.seed,
            length=collect.episode_steps,
            episodes=tuple(missing[first : first + CHUNK]),
            folder=run.work,
        )
        for first in range(0, len(missing), CHUNK)
    ]
    with job.progress.task("collect (episodes)", len(shards)) as advance:
        advance(len(shards) - len(missing))
        for done in each(_collect_chunk, chunks, workers=job.workers):
            advance(done)
    attrs: dict[str, str | int | float] = {
        "elast_version": elast_cli.__version__,
        "env": job.env,
        "env_id": spec(job.env).gym_id,
        "seed": job.seed,
    }
    try:
        compact(shards, run.staging / DATASET_FILE, attrs=attrs)
    except DataError as damage:  # of what this run, or the one it continues, has collected
        raise DataError(f"{damage}; the same command with --fresh collects all anew") from None
    return {
        "episodes": len(shards),
        "transitions": len(shards) * collect.episode_steps,
        "wall_s": round(time.monotonic() - began, 3),
    }


def _collect_chunk(chunk: _Chunk) -> int:
    """Number of episodes written; each is the same whoever runs it, and may be run again."""
    env = make(chunk.env, chunk.config)
    policy = RandomPolicy(env.action_size, chunk.policy)
    for index in chunk.episodes:
        episode = collect_episode(
            env, seed=chunk.seed, index=index, length=chunk.length, policy=policy
        )
        write_shard(shard_path(chunk.folder, index), episode)
    return len(chunk.episodes)
