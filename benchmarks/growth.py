"""How planning time grows with the budget, at a fixed batch: the exponent of a power law."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.document import Figure
from benchmarks.trained import Bench, row, timed
from elast_cli.methods import elast_planner

BATCH, SCENARIOS = 32, 3


def figures(bench: Bench) -> list[Figure]:
    """The slope of log time over log expansions; nearly linear is what the cells are for."""
    query = bench.query(SCENARIOS)
    elast_planner(bench.models, bench.tree(expansions=100)).plan(row(query, 0))  # compiles
    times = {}
    for expansions in bench.sizes.growth:
        config = bench.tree(expansions=expansions, batch_min=BATCH, batch_max=BATCH)
        planner = elast_planner(bench.models, config)
        runs = [
            timed(partial(planner.plan, row(query, b)), bench.sizes.repeats)[0]
            for b in range(SCENARIOS)
        ]
        times[expansions] = sum(runs) / SCENARIOS
    exponent = float(np.polyfit(np.log(list(times)), np.log(list(times.values())), 1)[0])
    return [
        Figure(
            measurement="growth",
            name=f"exponent of time in expansions, batches of {BATCH}",
            ratio=exponent,
            seconds={f"{expansions:,}": seconds for expansions, seconds in times.items()},
        )
    ]
