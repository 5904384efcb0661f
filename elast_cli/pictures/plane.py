"""What is drawn in a plane of the latent space: data, trees, paths, start and goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elast_cli.pictures.canvas import GOAL, PATH, START

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection

Points = NDArray[np.floating]  # [N, 2]

WIDE = 1.9  # a cloud this many times wider than high gets the whole width
CLOUD = "#e3e5e9"
TREE_COLOURS = ["#cfe3ef", "#86b6d6", "#4b86b8", "#4a4f9c", "#4b2a7b"]
PROJECTIONS = {"isomap": "Isomap", "pca": "PCA"}


@dataclass(frozen=True)
class Place:
    """The plane as it is drawn: `sign` is -1 where it is mirrored."""

    sign: float
    aspect: float  # width over height of all that is shown

    @classmethod
    def of(cls, shown: Sequence[Points], start: Points, goal: Points) -> Place:
        """The plane for points [N,2], mirrored where a wide one would lead from right to left."""
        width, height = np.ptp(np.concatenate(list(shown)), axis=0)
        aspect = float(width / max(height, 1e-9))
        turned = aspect > WIDE and start[0] > goal[0]
        return cls(sign=-1.0 if turned else 1.0, aspect=aspect)

    def __call__(self, xy: Points) -> Points:
        """Where points [N,2] are drawn."""
        return np.asarray(xy * np.array([self.sign, 1.0]))


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


def draw_cloud(panel: Axes, xy: Points) -> None:
    """The data [N,2] in grey."""
    panel.scatter(xy[:, 0], xy[:, 1], s=7, color=CLOUD, lw=0, zorder=1)


def draw_tree(panel: Axes, xy: Points, parents: NDArray[np.integer]) -> LineCollection:
    """A tree of nodes [N,2], darker the more steps from the start; its edges, for a scale."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    depth = depths(parents)
    child = np.flatnonzero(parents >= 0)
    child = child[np.argsort(depth[child], kind="stable")]
    ends = np.stack([xy[parents[child]], xy[child]], axis=1)
    colours = LinearSegmentedColormap.from_list("steps", TREE_COLOURS)
    edges = LineCollection(list(ends), cmap=colours, linewidths=0.5, alpha=0.75, zorder=2)
    edges.set_array(depth[child])
    panel.add_collection(edges)
    return edges


def draw_path(panel: Axes, xy: Points) -> None:
    """A path [T,2], if there is one."""
    if len(xy):
        panel.plot(xy[:, 0], xy[:, 1], color="white", lw=4.2, zorder=4, solid_capstyle="round")
        panel.plot(xy[:, 0], xy[:, 1], color=PATH, lw=2.2, zorder=5, solid_capstyle="round")


def draw_ends(panel: Axes, start: Points, goal: Points) -> None:
    """Start [2] and goal [2], named."""
    ends = ((start, "start", START, "o", 110), (goal, "goal", GOAL, "*", 260))
    for (x, y), name, colour, marker, size in ends:
        panel.scatter(
            [x], [y], s=size, color=colour, marker=marker, edgecolors="white", lw=1.4, zorder=8
        )
        label(panel, name, (x, y), offset=(9, -13), colour=colour, size=11)


def finish_panel(panel: Axes) -> None:
    """Equal units, and neither ticks nor a frame: the plane's axes mean nothing."""
    panel.set_aspect("equal", adjustable="datalim")
    panel.autoscale_view()
    panel.set_xticks([])
    panel.set_yticks([])
    panel.spines[:].set_visible(False)


def label(
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
