"""Paths side by side, each over its frames; edges that ψ rejects are marked (Fig. 8b)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.pictures.canvas import (
    FAINT,
    GOAL,
    INK,
    MUTED,
    START,
    Frame,
    Frames,
    figure_png,
    frame_grid,
    grid_shape,
)
from elast_cli.pictures.plane import (
    PROJECTIONS,
    Place,
    Points,
    draw_cloud,
    draw_ends,
    draw_path,
    finish_panel,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REJECTED = "#CC3377"
_WIDTH, _COLUMNS = 13.2, 8


@dataclass(frozen=True)
class PathPicture:
    """One path.

    Attributes:
        caption: above it.
        xy: its states [T,2].
        rejected: steps t whose edge, from state t-1 to state t, ψ rejects.
        steps: those shown as frames [K].
        frames: nearest data frames [K,64,64,3].
    """

    caption: str
    xy: Points
    rejected: Sequence[int]
    steps: Sequence[int]
    frames: Frames


@dataclass(frozen=True)
class PathsPicture:
    """Paths over the same data [M,2], start [2] and goal [2], whose frames are `ends`."""

    columns: Sequence[PathPicture]
    support_xy: Points
    start_xy: Points
    goal_xy: Points
    ends: tuple[Frame, Frame]
    title: str
    projection: str


def paths_figure(picture: PathsPicture, path: Path) -> None:
    """Paths as a PNG; a frame is marked where ψ rejects an edge since the frame before."""
    cloud = picture.support_xy
    place = Place.of([cloud, picture.goal_xy[None]], picture.start_xy, picture.goal_xy)
    most = max(len(column.frames) for column in picture.columns) + 2
    rows, columns = grid_shape(most, most=_COLUMNS)
    share = _WIDTH / len(picture.columns)
    strip, plane = rows * (share / columns + 0.24), min(6.0, max(2.5, share / place.aspect + 0.5))
    with figure_png(path, _WIDTH, strip + plane + 0.7) as figure:
        grid = figure.add_gridspec(2, len(picture.columns), height_ratios=[plane, strip])
        for at, column in enumerate(picture.columns):
            panel = figure.add_subplot(grid[0, at])
            draw_cloud(panel, place(cloud))
            _path(panel, place(column.xy), column.rejected)
            draw_ends(panel, place(picture.start_xy), place(picture.goal_xy))
            finish_panel(panel)
            panel.set_title(column.caption, loc="left", fontsize=9, color=INK)
            images = [picture.ends[0], *column.frames, picture.ends[1]]
            labels = ["start", *(f"step {step}" for step in column.steps), "goal"]
            colours = [START, *marks(column), GOAL]
            frame_grid(figure, grid[1, at], images, labels=labels, colours=colours, columns=columns)
        figure.suptitle(picture.title, x=0.004, ha="left", fontsize=13, fontweight="bold")
        note = f"{PROJECTIONS[picture.projection]} of the latent space · nearest data frames below"
        figure.supxlabel(f"pink: ψ rejects the edge · {note}", fontsize=8, color=MUTED)


def marks(column: PathPicture) -> list[str]:
    """The colour of each frame's border."""
    since = pairwise([0, *column.steps])
    return [
        REJECTED if any(before < step <= at for step in column.rejected) else FAINT
        for before, at in since
    ]


def _path(panel: Axes, xy: Points, rejected: Sequence[int]) -> None:
    """A path with its rejected edges over it."""
    from matplotlib.collections import LineCollection

    draw_path(panel, xy)
    edges = [np.stack([xy[t - 1], xy[t]]) for t in rejected]
    panel.add_collection(LineCollection(edges, colors=REJECTED, linewidths=4.5, zorder=6))
