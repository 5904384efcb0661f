"""How planning time grows at a fixed batch: exponents of power laws, in expansions and in nodes.

Copies are dropped, so the tree grows more slowly than the budget, and time with it. Where none are
dropped nearly every expansion is a node.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from pydantic import JsonValue

from benchmarks.document import Figure
from benchmarks.trained import Bench, row, timed
from elast_cli.methods.elast import tree_planner
from elast_cli.planners.base import Query
from elast_cli.planners.tree.search import ElastPlanner, Search

BATCH, SCENARIOS = 32, 3


class Growth(NamedTuple):
    """Mean seconds of a plan and nodes of its tree, for some budgets of expansions [n]."""

    expansions: list[int]
    seconds: list[float]
    nodes: list[float]


def figures(bench: Bench) -> list[Figure]:
    """Slopes of log time over the log of expansions, and of nodes where copies stay."""
    default, copies = measure(bench), measure(bench, duplicate_steps=0.0)
    found = [
        ("exponent of time in expansions", default, exponent(default.expansions, default.seconds)),
        ("exponent of time in nodes, copies kept", copies, exponent(copies.nodes, copies.seconds)),
    ]
    return [
        Figure(
            measurement="growth",
            name=f"{name}, batches of {BATCH}",
            ratio=slope,
            seconds={f"{n:,}": t for n, t in zip(growth.expansions, growth.seconds, strict=True)},
            facts={"nodes": [round(nodes) for nodes in growth.nodes]},
        )
        for name, growth, slope in found
    ]


def measure(bench: Bench, **changes: JsonValue) -> Growth:
    """Plan with every budget of expansions, with some changes to the search."""
    query = bench.query(SCENARIOS)
    warm = bench.tree(expansions=100, **changes)
    tree_planner(bench.models, warm).plan(row(query, 0))  # compiles
    seconds, nodes = [], []
    for expansions in bench.sizes.growth:
        config = bench.tree(expansions=expansions, batch={"min": BATCH, "max": BATCH}, **changes)
        planner = tree_planner(bench.models, config)
        runs = [
            timed(partial(nodes_of_plan, planner, row(query, b)), bench.sizes.repeats)
            for b in range(SCENARIOS)
        ]
        seconds.append(float(np.mean([spent for spent, _ in runs])))
        nodes.append(float(np.mean([size for _, size in runs])))
    return Growth(list(bench.sizes.growth), seconds, nodes)


def nodes_of_plan(planner: ElastPlanner, query: Query) -> int:
    """Plan for one scenario, and count the nodes of its tree."""
    search = Search(planner, query)
    search.run()
    search.best_plan()
    return int(search.forest.size[0])


def exponent(x: list[int] | list[float], y: list[float]) -> float | None:
    """The slope of log y over log x; None where all x are the same."""
    if len(set(x)) == 1:
        return None
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
