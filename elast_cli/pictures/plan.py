"""A plan's picture: its tree in a plane of the latent space, and frames along the path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from elast_cli.pictures.canvas import (
    FAINT,
    GOAL,
    MUTED,
    PATH,
    START,
    Frame,
    Frames,
    figure_png,
    frame_grid,
    grid_shape,
)
from elast_cli.pictures.plane import (
    PROJECTIONS,
    WIDE,
    Place,
    Points,
    draw_cloud,
    draw_ends,
    draw_path,
    draw_tree,
    finish_panel,
    label,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 13.2  # inches


@dataclass(frozen=True)
class PlanPicture:
    """What a plan's picture shows; all points in the plane of one projection.

    `path_steps` says at which step each frame stands (indices into `path_xy`).
    """

    nodes_xy: Points  # [N, 2]
    parents: NDArray[np.integer]  # [N], -1 at the root
    path_xy: Points  # [T, 2], empty where there is no path
    start_xy: Points  # [2]
    goal_xy: Points  # [2]
    support_xy: Points  # [M, 2] encoded data
    frames: Frames  # [K, H, W, 3] along the path
    path_steps: Sequence[int]  # [K]
    start: Frame
    goal: Frame
    title: str
    lines: Sequence[str] = field(default_factory=tuple)  # figures under the title
    projection: str = "isomap"


def plan_figure(picture: PlanPicture, path: Path) -> None:
    """A plan as a PNG: tree and path in the plane, and the frames along the path.

    The frames stand beside the tree, or under it where the latent space unrolls to a long band;
    such a band is mirrored, if need be, so that the path runs from left to right.
    """
    shown = [picture.nodes_xy, picture.support_xy, picture.goal_xy[None]]
    place = Place.of(shown, picture.start_xy, picture.goal_xy)
    images = [picture.start, *picture.frames, picture.goal]
    labels = ["start", *(f"step {step}" for step in picture.path_steps), "goal"]
    colours = [START, *[FAINT] * len(picture.frames), GOAL]
    wide = place.aspect > WIDE
    rows, columns = grid_shape(len(images), most=10 if wide else max(4, _root(len(images))))
    share = _WIDTH if wide else _WIDTH / 2
    strip = rows * (share / columns + 0.24)  # inches of the frames
    tree = min(5.0, max(3.0, _WIDTH / place.aspect + 0.9)) if wide else 0.0
    height = tree + strip + 0.6 if wide else max(6.0, strip + 0.6)
    with figure_png(path, _WIDTH, height) as figure:
        if wide:
            grid = figure.add_gridspec(2, 1, height_ratios=[tree, strip])
        else:
            grid = figure.add_gridspec(1, 2, width_ratios=[1.0, 1.02])
        panel = figure.add_subplot(grid[0])
        _tree(figure, panel, picture, place)
        _path(panel, picture, place)
        frame_grid(figure, grid[1], images, labels=labels, colours=colours, columns=columns)
        figure.suptitle(picture.title, x=0.004, ha="left", fontsize=13, fontweight="bold")


def _root(count: int) -> int:
    """The least whole number whose square holds `count`."""
    return int(np.ceil(np.sqrt(count)))


def _tree(figure: Figure, panel: Axes, picture: PlanPicture, place: Place) -> None:
    """The data as a grey cloud, and the tree over it, darker the more steps from the start."""
    draw_cloud(panel, place(picture.support_xy))
    edges = draw_tree(panel, place(picture.nodes_xy), picture.parents)
    if (picture.parents >= 0).any():
        bar = figure.colorbar(edges, ax=panel, location="bottom", shrink=0.35, aspect=40, pad=0.02)
        name = PROJECTIONS[picture.projection]
        nodes = f"{len(picture.nodes_xy):,} nodes"
        bar.set_label(f"steps from the start · {nodes} · {name} of the latent space", fontsize=8)
        bar.outline.set_visible(False)
        bar.ax.tick_params(length=0, labelsize=8, labelcolor=MUTED)
    finish_panel(panel)
    panel.set_title("\n".join(picture.lines), loc="left", fontsize=9, color=MUTED)


def _path(panel: Axes, picture: PlanPicture, place: Place) -> None:
    """The path, the steps shown as frames, the start and the goal."""
    xy = place(picture.path_xy)
    draw_path(panel, xy)
    if len(xy):
        shown = xy[list(picture.path_steps)]
        dots: dict[str, Any] = {"color": "white", "edgecolors": PATH, "lw": 1.4}
        panel.scatter(shown[:, 0], shown[:, 1], s=26, zorder=6, **dots)
        for step, (x, y) in zip(picture.path_steps, shown, strict=True):
            label(panel, str(step), (x, y), offset=(4, 4), colour=PATH, size=7)
    draw_ends(panel, place(picture.start_xy), place(picture.goal_xy))
