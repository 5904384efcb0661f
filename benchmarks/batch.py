"""A plan in batches against one expansion at a time: by our own engine, and written plainly."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.document import Figure
from benchmarks.serial import TorchNetworks, plan_serially
from benchmarks.trained import Bench, row, timed
from elast_cli.config import JsonDict
from elast_cli.methods.elast import tree_planner
from elast_cli.planners.base import Query

AIM = 15.0
ONE_BY_ONE: JsonDict = {"min": 1, "max": 1}
REPEATS = 2  # of every plan, at most: the serial ones take seconds each


def figures(bench: Bench) -> list[Figure]:
    """Two baselines, for one scenario and for several at once; times are of one plan."""
    sizes, config = bench.sizes, bench.tree()
    repeats = min(REPEATS, sizes.repeats)
    planner = tree_planner(bench.models, config)
    one_by_one = tree_planner(bench.models, bench.tree(batch=ONE_BY_ONE))
    query = bench.query(sizes.rows)
    planner.plan(row(query, 0))  # compiles, or loads what was compiled
    rows = [row(query, b) for b in range(sizes.serial_rows)]
    lengths: dict[str, Callable[[Query], int]] = {
        "our engine one by one": lambda q: int(one_by_one.plan(q).length[0]),
        "plain numpy and torch": _plain(bench),
    }
    baselines = {
        name: [_solo(length, one, repeats) for one in rows] for name, length in lengths.items()
    }
    found = []
    for count, at_once in ((1, row(query, 0)), (sizes.rows, query)):
        seconds, plan = timed(partial(planner.plan, at_once), repeats)
        for name, runs in baselines.items():
            slow, steps = np.mean(runs[:count], axis=0)
            found.append(
                Figure(
                    measurement="batch",
                    name=f"{count} at once against {name}",
                    ratio=slow * count / seconds,
                    at_least=AIM,
                    seconds={"a plan": seconds / count, "one by one": slow},
                    facts={
                        "reached": f"{plan.reached.sum()}/{count}",
                        "steps": float(plan.length.mean() - 1),
                        "steps one by one": float(steps),
                        "plans one by one": len(runs[:count]),
                    },
                )
            )
    return found


def _plain(bench: Bench) -> Callable[[Query], int]:
    """The plain program: from a query without a context to its path's number of states."""
    config = bench.tree()
    engine = tree_planner(bench.models, config)
    networks = TorchNetworks(bench.models, np.zeros(0, np.float32))

    def length(query: Query) -> int:
        found = plan_serially(networks, config, engine.limits, engine.radii, query)
        return len(found.states)

    return length


def _solo(length: Callable[[Query], int], query: Query, repeats: int) -> tuple[float, int]:
    """Seconds and steps of a plan made by a function that returns its number of states."""
    seconds, states = timed(lambda: length(query), repeats)
    return seconds, states - 1
