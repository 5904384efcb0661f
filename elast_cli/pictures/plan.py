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
    START,
    Frame,
    Frames,
    figure_png,
    frame_grid,
    grid_shape,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Points = NDArray[np.floating]  # [N, 2]

PATH = "#D55E00"
_TREE_COLOURS = ["#cfe3ef", "#86b6d6", "#4b86b8", "#4a4f9c", "#4b2a7b"]
_WIDTH = 13.2  # inches
_WIDE = 1.9  # a cloud this many times wider than high gets the whole width


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
    place = _Plane.of(picture)
    images = [picture.start, *picture.frames, picture.goal]
    labels = ["start", *(f"step {step}" for step in picture.path_steps), "goal"]
    colours = [START, *[FAINT] * len(picture.frames), GOAL]
    wide = place.aspect > _WIDE
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


@dataclass(frozen=True)
class _Plane:
    """The plane as it is drawn: `sign` is -1 where it is mirrored."""

    sign: float
    aspect: float  # width over height of all that is shown

    @classmethod
    def of(cls, picture: PlanPicture) -> _Plane:
        shown = np.concatenate([picture.nodes_xy, picture.support_xy, picture.goal_xy[None]])
        width, height = np.ptp(shown, axis=0)
        aspect = float(width / max(height, 1e-9))
        turned = aspect > _WIDE and picture.start_xy[0] > picture.goal_xy[0]
        return cls(sign=-1.0 if turned else 1.0, aspect=aspect)

    def __call__(self, xy: Points) -> Points:
        return np.asarray(xy * np.array([self.sign, 1.0]))


def _root(count: int) -> int:
    """The least whole number whose square holds `count`."""
    return int(np.ceil(np.sqrt(count)))


def depths(parents: NDArray[np.integer]) -> NDArray[np.int64]:
    """Steps from the root to each node, [N]; parents may stand behind their children."""
    above = np.asarray(parents, dtype=np.int64)
    depth = np.zeros(len(above), dtype=np.int64)
    node = above.copy()
    while (node >= 0).any():
        depth += node >= 0
        if depth.max(initial=0) > len(above):
            raise ValueError("the parents run in a circle")
        node = np.where(node >= 0, above[node], -1)
    return depth


def _tree(figure: Figure, panel: Axes, picture: PlanPicture, place: _Plane) -> None:
    """The data as a grey cloud, and the tree over it, darker the more steps from the start."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    cloud, nodes = place(picture.support_xy), place(picture.nodes_xy)
    panel.scatter(cloud[:, 0], cloud[:, 1], s=7, color="#e3e5e9", lw=0, zorder=1)
    child = np.flatnonzero(picture.parents >= 0)
    child = child[np.argsort(depths(picture.parents)[child], kind="stable")]
    ends = np.stack([nodes[picture.parents[child]], nodes[child]], axis=1)
    colours = LinearSegmentedColormap.from_list("steps", _TREE_COLOURS)
    edges = LineCollection(list(ends), cmap=colours, linewidths=0.5, alpha=0.75, zorder=2)
    edges.set_array(depths(picture.parents)[child])
    panel.add_collection(edges)
    if len(child):
        bar = figure.colorbar(edges, ax=panel, location="bottom", shrink=0.35, aspect=40, pad=0.02)
        name = {"isomap": "Isomap", "pca": "PCA"}.get(picture.projection, picture.projection)
        text = f"steps from the start · {len(nodes):,} nodes · {name} of the latent space"
        bar.set_label(text, fontsize=8)
        bar.outline.set_visible(False)
        bar.ax.tick_params(length=0, labelsize=8, labelcolor=MUTED)
    panel.set_aspect("equal", adjustable="datalim")
    panel.autoscale_view()
    panel.set_xticks([])
    panel.set_yticks([])
    panel.spines[:].set_visible(False)
    panel.set_title("\n".join(picture.lines), loc="left", fontsize=9, color=MUTED)


def _path(panel: Axes, picture: PlanPicture, place: _Plane) -> None:
    """The path, the steps shown as frames, the start and the goal."""
    xy = place(picture.path_xy)
    if len(xy):
        panel.plot(xy[:, 0], xy[:, 1], color="white", lw=4.2, zorder=4, solid_capstyle="round")
        panel.plot(xy[:, 0], xy[:, 1], color=PATH, lw=2.2, zorder=5, solid_capstyle="round")
        shown = xy[list(picture.path_steps)]
        dots: dict[str, Any] = {"color": "white", "edgecolors": PATH, "lw": 1.4}
        panel.scatter(shown[:, 0], shown[:, 1], s=26, zorder=6, **dots)
        for step, (x, y) in zip(picture.path_steps, shown, strict=True):
            _label(panel, str(step), (x, y), offset=(4, 4), colour=PATH, size=7)
    ends = (
        (place(picture.start_xy), "start", START, "o", 110),
        (place(picture.goal_xy), "goal", GOAL, "*", 260),
    )
    for (x, y), name, colour, marker, size in ends:
        panel.scatter(
            [x], [y], s=size, color=colour, marker=marker, edgecolors="white", lw=1.4, zorder=8
        )
        _label(panel, name, (x, y), offset=(9, -13), colour=colour, size=11)


def _label(
    panel: Axes,
    text: str,
    point: tuple[float, float],
    *,
    offset: tuple[float, float],
    colour: str,
    size: float,
) -> None:
    """Text beside a point, with a white halo."""
    from matplotlib.patheffects import withStroke

    panel.annotate(
        text,
        point,
        offset,
        textcoords="offset points",
        color=colour,
        fontsize=size,
        fontweight="bold",
        zorder=9,
        path_effects=[withStroke(linewidth=3, foreground="white")],
    )
