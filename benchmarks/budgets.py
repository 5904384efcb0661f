"""Success against planning time: `python -m benchmarks.budgets`, on models that are there.

ELAST and CPC-CEM plan with the same number of predicted transitions a plan, from 5·10³ to 5·10⁵; a
transition that each of m members predicts counts m times. A tree stops earlier once its path cannot
be improved, CEM never does. The labels in the picture are the budgets.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from elast_cli.envs.registry import task_info
from elast_cli.pictures.canvas import METHOD_COLOURS, figure_png

BUDGETS = (5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000)
PER_EXPANSION = 6.75  # transitions: five members, and a round trip for every third
CEM_ROUNDS = 30 * 10  # horizon by iterations: transitions of a sample
PLANS = {"elast": "trees of ELAST", "cpc-cem": "CPC-CEM"}


def settings(method: str, budget: int) -> list[str]:
    """What `--set` is given so that a plan costs about `budget` transitions, or fewer.

    A plan of CPC-CEM never costs more. How many an expansion of ELAST costs is a mean, so a plan
    may cost some more than the budget; what plans did cost is measured.
    """
    if method == "elast":
        expansions = int(budget // PER_EXPANSION)
        return [f"planner.expansions={expansions}", "planner.reuse.expansions=2000"]
    samples = budget // CEM_ROUNDS
    return [f"cem.num_samples={samples}", f"cem.topk={max(2, samples // 10)}"]


def measured(method: str, budget: int, words: Sequence[str]) -> dict[str, Any]:
    """Evaluate a method within a budget; its row, with the seconds and transitions a plan.

    Transitions are the mean over all plans, and the most that plans of one episode had on average.
    """
    changes = [word for change in settings(method, budget) for word in ("--set", change)]
    command = ["elast", "eval", "--methods", method, "--json", "--quiet", *words, *changes]
    runner = [sys.executable, "-m", "elast_cli", *command[1:]]
    done = subprocess.run(runner, check=True, capture_output=True, text=True)
    results = json.loads(done.stdout)
    [overall] = [row for row in results["overall"] if row["train_seed"] is None]
    episodes = results["per_episode"]
    plans = sum(row["plans"] for row in episodes)
    seconds = sum(row["plan_s"] * row["plans"] for row in episodes)  # plan_s is of one plan
    spent = [transitions(row) for row in episodes]
    return {
        "method": method,
        "budget": budget,
        "pc_success": overall["pc_success"],
        "ci95": overall["ci95"],
        "seconds_a_plan": seconds / plans,
        "seconds_a_first_plan": sum(row["first_plan_s"] for row in episodes) / len(episodes),
        "transitions_a_plan": sum(spent) / plans,
        "most_transitions_a_plan": max(
            all_plans / row["plans"] for all_plans, row in zip(spent, episodes, strict=True)
        ),
        "reached": sum(row["reached"] for row in episodes) / plans,
        "command": " ".join(command),
    }


def transitions(row: Mapping[str, Any]) -> float:
    """Predicted transitions of all plans of an episode, from its row of the results."""
    most = task_info(row["env"]).level(row["level"]).max_steps
    steps = most if row["steps"] is None else row["steps"]
    return float(row["network_calls_per_step"] * max(steps, 1))


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
        axes.set_xlabel("wall seconds of the first plan, ten episodes planned together")
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
