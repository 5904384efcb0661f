"""Success against planning time: `python -m benchmarks.budgets`, on models that are there.

ELAST and CPC-CEM plan with the same number of predicted transitions a plan, from 5·10³ to 5·10⁵; a
transition that each of m members predicts counts m times. A budget is a bound: a tree stops once
its path cannot be improved, CEM never does.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from elast_cli.plots import METHOD_COLOURS, figure_png

BUDGETS = (5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000)
PER_EXPANSION = 6.75  # transitions: five members, and a round trip for every third
CEM_ROUNDS = 30 * 10  # horizon by iterations: transitions of a sample
PLANS = {"elast": "trees of ELAST", "cpc-cem": "CPC-CEM"}


def settings(method: str, budget: int) -> list[str]:
    """What `--set` is given so that a plan costs no more than `budget` transitions."""
    if method == "elast":
        expansions = round(budget / PER_EXPANSION)
        return [f"planner.expansions={expansions}", "planner.replan_expansions=2000"]
    samples = round(budget / CEM_ROUNDS)
    return [f"cem.num_samples={samples}", f"cem.topk={max(2, samples // 10)}"]


def measured(method: str, budget: int, words: Sequence[str]) -> dict[str, Any]:
    """Evaluate a method within a budget; its row, with the seconds and transitions a plan."""
    changes = [word for change in settings(method, budget) for word in ("--set", change)]
    command = ["elast", "eval", "--methods", method, "--json", "--quiet", *words, *changes]
    runner = [sys.executable, "-m", "elast_cli", *command[1:]]
    done = subprocess.run(runner, check=True, capture_output=True, text=True)
    results = json.loads(done.stdout)
    [overall] = [row for row in results["overall"] if row["train_seed"] is None]
    episodes = results["per_episode"]
    plans = sum(row["plans"] for row in episodes)
    seconds = sum(row["plan_s"] * row["plans"] for row in episodes)  # plan_s is of one plan
    return {
        "method": method,
        "budget": budget,
        "pc_success": overall["pc_success"],
        "ci95": overall["ci95"],
        "seconds_a_plan": seconds / plans,
        "seconds_a_first_plan": sum(row["first_plan_s"] for row in episodes) / len(episodes),
        "reached": sum(row["reached"] for row in episodes) / plans,
        "command": " ".join(command),
    }


def plot(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Success with 95 % intervals against the seconds that the first plan takes."""
    with figure_png(path, 6.2, 3.6) as figure:
        axes = figure.subplots()
        for method, label in PLANS.items():
            own = [row for row in rows if row["method"] == method]
            x = [row["seconds_a_first_plan"] for row in own]
            y = [row["pc_success"] for row in own]
            ends = [[y[i] - row["ci95"][0] for i, row in enumerate(own)]]
            ends += [[row["ci95"][1] - y[i] for i, row in enumerate(own)]]
            colour = METHOD_COLOURS[method]
            axes.errorbar(x, y, yerr=ends, color=colour, label=label, marker="o", capsize=3)
            for at, row in enumerate(own):
                text = f"{row['budget'] / 1000:g}k"
                offset = (0, 6 if method == "elast" else -12)
                axes.annotate(
                    text,
                    (x[at], y[at]),
                    offset,
                    textcoords="offset points",
                    fontsize=7,
                    ha="center",
                )
        axes.set(xscale="log", ylim=(-3, 108), ylabel="success, %")
        axes.set_xlabel("seconds for the first plan of an episode (one core); labels: transitions")
        axes.legend(frameon=False, loc="center right")
        axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Measure, and write JSON and PNG."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.budgets", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/results/budgets.json"))
    parser.add_argument("--picture", type=Path, default=Path("docs/pictures/budgets.png"))
    parser.add_argument("words", nargs="*", help="for elast eval: -- --env ... --level ...")
    arguments = parser.parse_args()
    rows = []
    for budget in BUDGETS:
        for method in PLANS:
            rows.append(measured(method, budget, arguments.words))
            sys.stderr.write(f"{json.dumps(rows[-1])}\n")
            arguments.out.write_text(json.dumps(rows, indent=1) + "\n")
    plot(rows, arguments.picture)


if __name__ == "__main__":
    main()
