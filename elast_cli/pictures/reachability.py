"""The states near one, by whether ψ finds them reachable (Fig. 8a)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elast_cli.pictures.canvas import GOAL, INK, MUTED, START, figure_png
from elast_cli.pictures.plane import PROJECTIONS, Points, draw_cloud, finish_panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CHOSEN = "#0072B2"
_TITLES = ("states that can be reached from it", "states from which it can be reached")


@dataclass(frozen=True)
class ReachabilityPicture:
    """Training states, and those near a chosen one.

    Attributes:
        support_xy: training states in the plane [M,2].
        near: indices of those near the chosen one [N].
        chosen: its index.
        reachable: of those near it, whether ψ finds a step to them likely, and one from them [N].
        title: of the picture.
        note: under it.
        projection: of the plane.
    """

    support_xy: Points
    near: NDArray[np.integer]
    chosen: int
    reachable: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    title: str
    note: str
    projection: str


def reachability_figure(picture: ReachabilityPicture, path: Path) -> None:
    """Both directions as a PNG, beside where in the whole latent space they are."""
    xy, centre = picture.support_xy, picture.support_xy[picture.chosen]
    near = xy[picture.near]
    half = 1.25 * max(np.abs(near - centre).max(initial=0), 1e-6)
    with figure_png(path, 13.2, 5.0) as figure:
        whole, *both = figure.subplots(1, 3)
        draw_cloud(whole, xy)
        whole.scatter(near[:, 0], near[:, 1], s=7, color=MUTED, lw=0, zorder=2)
        _mark(whole, centre)
        finish_panel(whole)
        whole.set_title("all training states; dark: near it", loc="left", fontsize=9, color=INK)
        for panel, reachable, title in zip(both, picture.reachable, _TITLES, strict=True):
            draw_cloud(panel, xy)
            _draw(panel, near, reachable)
            _mark(panel, centre)
            finish_panel(panel)
            panel.set_adjustable("box")
            panel.set_xlim(centre[0] - half, centre[0] + half)
            panel.set_ylim(centre[1] - half, centre[1] + half)
            count = f"{int(reachable.sum())} of {len(reachable)}"
            panel.set_title(f"{title}: {count}", loc="left", fontsize=9, color=INK)
        figure.suptitle(picture.title, x=0.004, ha="left", fontsize=13, fontweight="bold")
        note = f"green: reachable · red cross: not · {picture.note}"
        figure.supxlabel(f"{note} · {PROJECTIONS[picture.projection]}", fontsize=8, color=MUTED)


def _draw(panel: Axes, near: Points, reachable: NDArray[np.bool_]) -> None:
    yes, no = near[reachable], near[~reachable]
    panel.scatter(no[:, 0], no[:, 1], s=16, color=GOAL, marker="x", lw=0.9, zorder=3)
    panel.scatter(yes[:, 0], yes[:, 1], s=20, color=START, lw=0, zorder=4)


def _mark(panel: Axes, centre: Points) -> None:
    """The chosen state."""
    panel.scatter(centre[:1], centre[1:], s=130, color=CHOSEN, edgecolors="white", lw=1.4, zorder=8)
