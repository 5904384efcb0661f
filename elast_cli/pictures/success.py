"""The bar chart of success rates."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from elast_cli.evaluation.rows import OverallRow
from elast_cli.evaluation.summary import grouped, pooled
from elast_cli.pictures.canvas import FAINT, INK, MUTED, colour_of, figure_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def bar_chart(overall: Sequence[OverallRow], path: Path, *, title: str = "") -> None:
    """Success rates as a PNG: a panel per (env, level), a bar per method, Wilson whiskers.

    Uses the pooled rows; dots are the single training seeds where there are several.
    """
    rows = pooled(overall)
    tasks = grouped(rows, lambda row: (row.env, row.level))
    methods = list(dict.fromkeys(row.method for row in rows))
    columns = max(1, min(3, len(tasks)))
    lines = max(1, -(-len(tasks) // columns))
    width, height = 1.6 + 3.9 * columns, 0.55 + lines * (0.85 + 0.34 * len(methods))
    with figure_png(path, width, height) as figure:
        panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
        for panel, (task, of_task) in zip(panels, tasks.items(), strict=False):
            _bars(panel, methods, of_task)
            panel.set_title(" ".join(task), fontsize=10, fontweight="bold", loc="left", color=INK)
        for panel in panels[len(tasks) :]:
            panel.set_visible(False)
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")


def _bars(panel: Axes, methods: Sequence[str], rows: Sequence[OverallRow]) -> None:
    """One panel: a line per method, the first on top."""
    by_method = {row.method: row for row in rows}
    for at, method in enumerate(methods):
        row = by_method.get(method)
        if row is None:
            panel.text(1, at, "not evaluated", va="center", fontsize=8, color=MUTED)
        else:
            _bar(panel, at, row)
    panel.set_yticks(range(len(methods)), methods)
    panel.set_ylim(len(methods) - 0.45, -0.55)
    panel.set_xlim(0, 100)
    panel.set_xticks([0, 25, 50, 75, 100])
    panel.grid(axis="x", color=FAINT, lw=0.6, zorder=0)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    panel.set_xlabel(_label(rows), fontsize=8)


def _bar(panel: Axes, at: int, row: OverallRow) -> None:
    """A rate with its interval, the rates of single training seeds, and both as numbers."""
    low, high = row.ci95
    panel.barh(at, row.pc_success, height=0.62, color=colour_of(row.method), zorder=2)
    line: dict[str, Any] = {"color": INK, "zorder": 4, "clip_on": False}
    panel.plot([low, high], [at, at], lw=1.3, **line)
    panel.plot([low, high], [at, at], ls="", marker="|", ms=6, mew=1.3, **line)
    seeds = row.pc_success_by_seed or {}
    if len(seeds) > 1:
        dots: dict[str, Any] = {"s": 13, "color": "white", "edgecolors": INK, "lw": 0.8}
        height = [at + 0.2] * len(seeds)
        panel.scatter(list(seeds.values()), height, zorder=5, clip_on=False, **dots)
    panel.text(104, at, f"{row.pc_success:.0f}", va="center", fontweight="bold")
    panel.text(117, at, f"[{low:.0f}, {high:.0f}]", va="center", fontsize=8, color=MUTED)


def _label(rows: Sequence[OverallRow]) -> str:
    """What a panel's axis shows."""
    counts = sorted({row.n_episodes for row in rows})
    episodes = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    seeds_shown = any(len(row.pc_success_by_seed or {}) > 1 for row in rows)
    dots = "; dots: training seeds" if seeds_shown else ""
    return f"success %, 95 % interval, {episodes} episodes{dots}"
