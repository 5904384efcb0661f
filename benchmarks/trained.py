"""Trained models and planning problems to measure with; models are made once and kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from pydantic import JsonValue

from benchmarks.document import ROOT
from elast_cli.control.collection import CollectConfig
from elast_cli.data.dataset import Dataset
from elast_cli.envs.registry import ENVS, make, scenarios
from elast_cli.methods.loading import Models
from elast_cli.methods.sight import frame_encoder
from elast_cli.methods.table import METHODS
from elast_cli.models.parts import DATASET
from elast_cli.planners.base import Query
from elast_cli.planners.tree.config import TreeConfig
from elast_cli.progress import Progress, Silent
from elast_cli.shapes import FRAMES
from elast_cli.stages import presets
from elast_cli.stages.chain import make_models
from elast_cli.stages.collect import DATASET_FILE
from elast_cli.stages.job import Job
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

R = TypeVar("R")
ENV, LEVEL = "block-s", "hard"
HOME = ROOT / "build" / "bench"


def standard(*envs: str) -> dict[str, int]:
    """Transitions that the preset `standard` collects in each environment."""
    return {env: presets.load("standard", env).section("collect", CollectConfig).n for env in envs}


@dataclass(frozen=True)
class Sizes:
    """How much is measured.

    Attributes:
        overrides: of the preset `quick`, for the models.
        expansions: of a plan.
        rows: scenarios planned for at once, in the larger of two batches.
        serial_rows: of these, how many are also planned one expansion at a time.
        repeats: of short measurements, of which the least counts.
        growth: budgets of expansions.
        episodes: for replanning.
        steps: of training.
        collect: transitions of each environment; as many as `standard` collects.
        nodes, trees: of the comparison with RRT*: nodes a tree, and how many trees.
    """

    overrides: tuple[str, ...] = ()
    expansions: int = 10_000
    rows: int = 10
    serial_rows: int = 10
    repeats: int = 3
    growth: tuple[int, ...] = (16_000, 32_000, 64_000)
    episodes: int = 20
    steps: int = 1500
    collect: Mapping[str, int] = field(default_factory=lambda: standard(*ENVS))
    nodes: int = 4000
    trees: int = 20


FULL = Sizes()
QUICK = Sizes(
    overrides=(
        "collect.n=15000",
        "encoder.fit.steps=500",
        "ensemble.fit.steps=800",
        "density.fit.steps=500",
        "policy.fit.steps=800",
    ),
    serial_rows=2,
    repeats=1,
    growth=(8_000, 16_000, 32_000),
    episodes=3,
    steps=250,
    collect={"block-s": 15_000, "cable": 15_000},
    nodes=4000,
    trees=3,
)


@dataclass(frozen=True)
class Bench:
    """What every measurement is given; models are trained when the first one asks for them."""

    sizes: Sizes
    quick: bool = False
    home: Path = HOME
    workers: int = 1
    progress: Progress = field(default_factory=Silent)

    @cached_property
    def job(self) -> Job:
        """BlockS with the preset `quick`, perhaps made smaller."""
        return Job(
            store=Store(self.home),
            env=ENV,
            preset="quick",
            config=presets.load("quick", ENV, self.sizes.overrides),
            workers=self.workers,
            progress=self.progress,
        )

    @cached_property
    def refs(self) -> dict[str, Ref]:
        """Dataset and models, made unless they are there."""
        return make_models(self.job, METHODS["elast"].parts)

    @cached_property
    def models(self) -> Models:
        """The models, on the CPU."""
        paths = {role: self.job.store.path(ref) for role, ref in self.refs.items()}
        return Models({role: at for role, at in paths.items() if role != DATASET}, "cpu")

    @cached_property
    def dataset(self) -> Dataset:
        """What they were trained on."""
        return Dataset.load(self.job.store.file(self.refs["dataset"], DATASET_FILE))

    def tree(self, **changes: JsonValue) -> TreeConfig:
        """The default search with the budget that is measured, and some changes."""
        planner = {"expansions": self.sizes.expansions, **changes}
        return self.job.config.changed({"planner": planner}, by="bench").section(
            "planner", TreeConfig
        )

    def query(self, rows: int) -> Query:
        """The first problems of the level, all of them unseen in training."""
        encode = frame_encoder(self.models)
        env = make(ENV, self.job.config.env)
        ends = []
        for scenario in scenarios(ENV, LEVEL, seed=0, count=rows, domain="scenario-val"):
            frame, info = env.reset(options={"scenario": scenario})
            stacks = [np.repeat(x[None, None], FRAMES, axis=1) for x in (frame, info["goal"])]
            ends.append([encode(stack, None)[0] for stack in stacks])
        start, goal = np.stack(ends, axis=1)
        return Query(start, goal, np.zeros((rows, 0), np.float32), np.arange(rows))


def row(query: Query, b: int) -> Query:
    """One row of a query that plans anew."""
    at = slice(b, b + 1)
    return Query(query.start[at], query.goal[at], query.context[at], query.seed[at])


def timed(run: Callable[[], R], repeats: int = 1) -> tuple[float, R]:
    """The least CPU time of some runs, in seconds, and what the last returned."""
    torch.set_num_threads(1)
    times = []
    for _ in range(repeats):
        began = time.process_time()
        result = run()
        times.append(time.process_time() - began)
    return min(times), result
