"""Where the time of a plan goes: cProfile's top lists of the batched and of the serial engine."""

from __future__ import annotations

import cProfile
import io
import pstats
import re

from benchmarks.batch import ONE_BY_ONE
from benchmarks.trained import Bench, row
from elast_cli.config import JsonDict
from elast_cli.methods.elast import tree_planner

LINES = 18


def page(bench: Bench) -> str:
    """A Markdown page with both lists, of the first scenario."""
    query = row(bench.query(1), 0)
    shown = []
    searches: tuple[tuple[str, JsonDict], ...] = (
        ("In batches (the default)", {}),
        ("One expansion at a time (`batch: {min: 1, max: 1}`)", {"batch": ONE_BY_ONE}),
    )
    for title, changes in searches:
        planner = tree_planner(bench.models, bench.tree(**changes))
        planner.plan(query)  # compiles
        profile = cProfile.Profile()
        profile.runcall(planner.plan, query)
        shown.append(f"## {title}\n\n{_indented(_top(profile))}\n")
    return f"""# Where a plan's time goes

Written by `make bench`: one plan of {bench.sizes.expansions:,} expansions for one BlockS-hard
scenario, by cProfile, by own time. A compiled kernel is no Python function: its time is its
caller's. Profiling itself makes Python calls look dearer than they are.

{chr(10).join(shown)}"""


def _top(profile: cProfile.Profile) -> str:
    out = io.StringIO()
    pstats.Stats(profile, stream=out).strip_dirs().sort_stats("tottime").print_stats(LINES)
    return re.sub(r"\n{2,}", "\n", out.getvalue()).strip()


def _indented(text: str) -> str:
    return "\n".join(f"    {line}".rstrip() for line in text.splitlines())
