"""`elast collect`: random interaction, shards of a few episodes, then one HDF5 file."""

from __future__ import annotations

import math
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import elast_cli
from elast_cli.config import JsonDict
from elast_cli.control.collection import CollectConfig, collect_episode
from elast_cli.data.chunks import CHUNK_ROWS
from elast_cli.data.layout import read_head
from elast_cli.data.shards import compact, shard_path, write_shard
from elast_cli.envs.random_policy import RandomPolicy, RandomPolicyConfig
from elast_cli.envs.registry import make, spec
from elast_cli.errors import DataError
from elast_cli.stages.job import Job, RecipeJob
from elast_cli.store.run import Run

ALGORITHM_VERSION = 1
DATASET_FILE = "dataset.h5"
SHARD_ROWS = 2048  # about so many, of episodes that are not longer


def recipe_job(job: Job) -> RecipeJob:
    """The dataset of a job."""
    config: JsonDict = {
        "collect": job.config.plain("collect"),
        "env": job.config.env,
    }
    recipe = job.recipe("dataset", config, {}, algorithm_version=ALGORITHM_VERSION, by_torch=False)
    return RecipeJob(job, recipe, {}, lambda run: _collect(job, run))


@dataclass(frozen=True)
class _Shard:
    """Consecutive episodes for one worker, and their file. A killed run loses one at most."""

    env: str
    config: JsonDict
    policy: RandomPolicyConfig
    seed: int
    length: int
    episodes: range
    path: Path


def _collect(job: Job, run: Run) -> JsonDict:
    began = time.monotonic()
    collect = job.config.section("collect", CollectConfig)
    shards = [
        _Shard(
            env=job.env,
            config=job.config.env,
            policy=collect.policy,
            seed=job.seed,
            length=collect.episode_steps,
            episodes=episodes,
            path=shard_path(run.work, episodes.start),
        )
        for episodes in _shares(collect.episodes, collect.episode_steps + 1)
    ]
    missing = [shard for shard in shards if not _is_there(shard)]
    there = collect.episodes - sum(len(shard.episodes) for shard in missing)
    if there:
        job.progress.note(f"collect: {there} episodes already exist")
    with job.progress.task("collect (episodes)", collect.episodes, there) as advance:
        for done in job.engine.each(_collect_shard, missing):
            advance(done)
    attrs: dict[str, str | int | float] = {
        "elast_version": elast_cli.__version__,
        "env": job.env,
        "env_id": spec(job.env).gym_id or str(job.config.env.get("id", "")),
        "seed": job.seed,
    }
    try:
        paths = [shard.path for shard in shards]
        lengths = [rows for path in paths for rows in read_head(path).lengths]
        compact(paths, run.staging / DATASET_FILE, attrs=attrs)
    except DataError as damage:  # of what this run, or the one it continues, has collected
        raise DataError(f"{damage}; run it again with --fresh") from None
    return {
        "episodes": collect.episodes,
        "transitions": sum(lengths) - len(lengths),
        "wall_s": round(time.monotonic() - began, 3),
    }


def _shares(episodes: int, rows: int) -> list[range]:
    """Episodes of each shard, the same for any number of workers; an episode has `rows` rows.

    If a shard of at most 2 * SHARD_ROWS rows can end where a chunk of images ends, it does: then
    nothing has to be compressed again when shards are put together.
    """
    size = max(SHARD_ROWS // rows, 1)
    even = CHUNK_ROWS // math.gcd(rows, CHUNK_ROWS)
    if even * rows <= 2 * SHARD_ROWS:
        size = even * max(round(size / even), 1)
    return [range(first, min(first + size, episodes)) for first in range(0, episodes, size)]


def _is_there(shard: _Shard) -> bool:
    """Whether a shard was collected before. A damaged one counts; `compact` reports it."""
    try:
        return shard.path.exists() and len(read_head(shard.path).lengths) == len(shard.episodes)
    except DataError:
        return True


def _collect_shard(shard: _Shard) -> int:
    """Number of episodes written. An episode does not depend on the worker, and may be repeated."""
    env = make(shard.env, shard.config)
    policy = RandomPolicy(env.task_info.action_size, shard.policy)
    episodes = (
        collect_episode(env, seed=shard.seed, index=index, length=shard.length, policy=policy)
        for index in shard.episodes
    )  # made one by one: memory that is used again costs far less than fresh memory
    with closing(env):
        write_shard(shard.path, episodes, first_row=shard.episodes.start * (shard.length + 1))
    return len(shard.episodes)
