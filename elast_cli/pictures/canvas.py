"""What all pictures share: colours, rows of frames, figures that become a PNG.

Matplotlib is imported where it is used and only through its Agg canvas, so no display is needed.
The same data give the same bytes. Colours are colour-blind safe, one per method everywhere.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

Frames = NDArray[np.uint8]  # [T, H, W, 3]
Frame = NDArray[np.uint8]  # [H, W, 3]
INK, MUTED, FAINT = "#1f2430", "#6b7280", "#d5d8de"
START, GOAL, PATH = "#009E73", "#CC3311", "#D55E00"
METHOD_COLOURS = {
    "elast": "#0072B2",
    "elast-psi": "#56B4E9",
    "elast-literal": "#8C6BB1",
    "cpc-cem": "#D55E00",
    "cpc-coll": "#E69F00",
    "cpc-grad": "#F0E442",
    "cpc-gcbc": "#009E73",
    "v-gcbc": "#66C2A5",
    "cpc-gcidm": "#1B4F72",
    "cpc-gciql": "#B5A900",
    "planet": "#CC79A7",
    "htm": "#A6761D",
    "knn-graph": "#117733",
    "random": "#999999",
}
_OTHER = "#4D4D4D"
_GAP, _LABEL, _EDGE = 0.08, 0.24, 0.02  # beside, under and round a frame, in its widths
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": MUTED,
    "xtick.color": MUTED,
    "ytick.color": INK,
}


def colour_of(method: str) -> str:
    """A method's colour; an ablation such as `elast-no-rewire` has its base's, lighter."""
    if method in METHOD_COLOURS:
        return METHOD_COLOURS[method]
    bases = [base for base in METHOD_COLOURS if method.startswith(f"{base}-")]
    if not bases:
        return _OTHER
    base = METHOD_COLOURS[max(bases, key=len)]
    channels = [int(base[at : at + 2], 16) for at in (1, 3, 5)]
    return "#" + "".join(f"{round(0.5 * channel + 0.5 * 255):02x}" for channel in channels)


def grid_shape(count: int, *, most: int) -> tuple[int, int]:
    """Rows and columns for `count` frames, at most `most` a row, the rows about equally long."""
    rows = -(-count // most)
    return rows, -(-count // rows)


def frame_grid(
    figure: Figure,
    place: SubplotSpec,
    images: Sequence[Frame],
    *,
    labels: Sequence[str],
    colours: Sequence[str],
    columns: int,
) -> None:
    """Frames in rows of `columns`, each with a border and a label under it.

    All in one panel, since panels are what drawing takes long over.
    """
    from matplotlib.patches import Rectangle

    rows = -(-len(images) // columns)
    across, down = 1 + _GAP, 1 + _LABEL  # in widths of a frame
    panel = figure.add_subplot(place)
    for at, (image, label, colour) in enumerate(zip(images, labels, colours, strict=True)):
        x, y = at % columns * across, at // columns * down
        panel.imshow(image, interpolation="nearest", extent=(x, x + 1, y + 1, y))
        plain = colour == FAINT
        line = 0.8 if plain else 2.2
        panel.add_patch(Rectangle((x, y), 1, 1, fill=False, color=colour, linewidth=line))
        panel.annotate(
            label,
            (x + 0.5, y + 1),
            xytext=(0, -4),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=8,
            color=MUTED if plain else colour,
            fontweight="normal" if plain else "bold",
        )
    panel.set(xlim=(-_EDGE, columns * across - _GAP + _EDGE), ylim=(rows * down, -_EDGE))
    panel.axis("off")


@contextmanager
def figure_png(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A white figure of `width` x `height` inches, written to `path` as a PNG at the end.

    The user's own matplotlib settings are left out, and so are time and version stamps.
    """
    _import_matplotlib()
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style.context(["default", _STYLE]):
        figure = Figure(figsize=(width, height), dpi=150, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        yield figure
        figure.savefig(path, format="png", metadata={"Software": None})


def _import_matplotlib() -> None:
    """Import it, whatever MPLBACKEND names: what a notebook sets it to need not be there."""
    if "matplotlib" in sys.modules:
        return
    kept = os.environ.pop("MPLBACKEND", None)
    import matplotlib

    if kept is not None:
        os.environ["MPLBACKEND"] = kept
        with suppress(ValueError):
            matplotlib.rcParams["backend"] = kept  # as the import would have done
