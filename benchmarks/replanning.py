"""The second and later plans of an episode, which reuse its tree, against the first."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.document import Figure
from benchmarks.trained import ENV, LEVEL, Bench, row
from elast_cli.control.episodes import run_episodes
from elast_cli.control.replan import Replan
from elast_cli.envs.registry import make, scenarios, task_info
from elast_cli.methods.elast import tree_planner
from elast_cli.methods.table import METHODS
from elast_cli.planners.base import Plan, Planner, Query
from elast_cli.planners.tree.config import TreeConfig


@dataclass
class Timed:
    """A planner that keeps the CPU time of each of its plans, first and later ones apart."""

    planner: Planner
    first: list[float] = field(default_factory=list)
    later: list[float] = field(default_factory=list)

    def plan(self, query: Query) -> Plan:
        """What the planner says; an episode's first query has no memory."""
        began = time.process_time()
        plan = self.planner.plan(query)
        seconds = time.process_time() - began
        (self.first if query.memory[0] is None else self.later).append(seconds)
        return plan


def warm_up(planner: Planner, query: Query) -> None:
    """Compile what first plans need, and what later ones need besides."""
    plan = planner.plan(query)
    planner.plan(replace(query, memory=plan.memory))


def figures(bench: Bench) -> list[Figure]:
    """Episodes one by one, with the default control and the preset's budget of expansions."""
    config = bench.job.config
    search = config.section("planner", TreeConfig)
    warm_up(tree_planner(bench.models, search), row(bench.query(1), 0))
    controller = METHODS["elast"].build(bench.models, config, ENV, 1)
    assert isinstance(controller, Replan)
    planner = Timed(controller.planner)
    controller = replace(controller, planner=planner)
    tasks = scenarios(ENV, LEVEL, seed=0, count=bench.sizes.episodes, domain="scenario-val")
    reached = 0
    for scenario in tasks:
        (trace,) = run_episodes(
            controller,
            [make(ENV, config.env)],
            [scenario],
            max_steps=task_info(ENV).level(LEVEL).max_steps,
            seeds=np.array([scenario.index]),
        )
        reached += trace.steps is not None
    if not planner.later:
        note = "no episode planned twice"
        name = "later plans over first ones"
        return [Figure(measurement="replanning", name=name, ratio=None, note=note)]
    first, later = float(np.mean(planner.first)), float(np.mean(planner.later))
    return [
        Figure(
            measurement="replanning",
            name="later plans over first ones",
            ratio=later / first,
            seconds={"a first plan": first, "a later plan": later},
            facts={
                "first plans": len(planner.first),
                "later plans": len(planner.later),
                "succeeded": f"{reached}/{len(tasks)}",
            },
        )
    ]
