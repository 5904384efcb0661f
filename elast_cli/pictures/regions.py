"""Explored regions side by side in one plane (Figs. 7 and 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elast_cli.pictures.canvas import INK, MUTED, PATH, figure_png
from elast_cli.pictures.plane import (
    PROJECTIONS,
    Place,
    Points,
    draw_cloud,
    draw_ends,
    draw_path,
    draw_tree,
    finish_panel,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VISITED = "#4b86b8"
_WIDTH = 13.2  # inches


@dataclass(frozen=True)
class Region:
    """One panel.

    Attributes:
        caption: above it.
        xy: nodes of a tree, or visited states [N,2].
        parents: of the nodes [N]; None where they are states of rollouts.
        path: the plan [T,2].
        last: states of the last rollouts [K·H,2], rollout by rollout.
        horizon: H.
    """

    caption: str
    xy: Points
    parents: NDArray[np.integer] | None
    path: Points
    last: Points
    horizon: int


@dataclass(frozen=True)
class RegionsPicture:
    """Rows of panels over the same data [M,2], start [2] and goal [2]."""

    rows: Sequence[Sequence[Region]]
    support_xy: Points
    start_xy: Points
    goal_xy: Points
    title: str
    projection: str


def regions_figure(picture: RegionsPicture, path: Path) -> None:
    """Explored regions as a PNG; of rollouts all states in blue, the last ones in orange."""
    cloud = picture.support_xy
    place = Place.of([cloud, picture.goal_xy[None]], picture.start_xy, picture.goal_xy)
    columns = max(map(len, picture.rows))
    panel_height = min(6.0, max(1.6, _WIDTH / columns / place.aspect)) + 0.5
    height = panel_height * len(picture.rows) + 0.7
    with figure_png(path, _WIDTH, height) as figure:
        panels = figure.subplots(len(picture.rows), columns, squeeze=False)
        for line, row in zip(panels, picture.rows, strict=True):
            for panel, region in zip(line, row, strict=True):
                _draw(panel, region, picture, place)
        figure.suptitle(picture.title, x=0.004, ha="left", fontsize=13, fontweight="bold")
        note = f"{PROJECTIONS[picture.projection]} of the latent space · grey: training states"
        figure.supxlabel(note, fontsize=8, color=MUTED)


def _draw(panel: Axes, region: Region, picture: RegionsPicture, place: Place) -> None:
    """One region. The data alone set the bounds: rollouts may leave them far behind."""
    from matplotlib.collections import LineCollection

    cloud, xy = place(picture.support_xy), place(region.xy)
    draw_cloud(panel, cloud)
    if region.parents is not None:
        draw_tree(panel, xy, region.parents)
    else:
        panel.scatter(xy[:, 0], xy[:, 1], s=3, color=VISITED, lw=0, alpha=0.35, zorder=2)
        lines = place(region.last).reshape(-1, region.horizon, 2)
        rollouts = LineCollection(list(lines), colors=PATH, linewidths=0.5, alpha=0.5, zorder=3)
        panel.add_collection(rollouts)
    draw_path(panel, place(region.path))
    draw_ends(panel, place(picture.start_xy), place(picture.goal_xy))
    finish_panel(panel)
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    panel.set_adjustable("box")
    margin = 0.06 * (high - low).max()
    panel.set_xlim(low[0] - margin, high[0] + margin)
    panel.set_ylim(low[1] - margin, high[1] + margin)
    panel.set_title(region.caption, loc="left", fontsize=9, color=INK)
