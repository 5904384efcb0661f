"""Pictures: success bars, film strips and animations; `plan_plot` adds the trees.

Matplotlib is imported where it is used and only through its Agg canvas, so no display is needed.
The same data give the same bytes. Colours are colour-blind safe, one per method everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from elast_cli.report import OverallRow, grouped, pooled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from PIL import Image

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
    "cpc-gcbc": "#009E73",
    "v-gcbc": "#66C2A5",
    "planet": "#CC79A7",
    "htm": "#A6761D",
    "random": "#999999",
}
_OTHER = "#4D4D4D"
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


# --- success rates -------------------------------------------------------------------------------


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
            continue
        low, high = row.ci95
        panel.barh(at, row.pc_success, height=0.62, color=colour_of(method), zorder=2)
        panel.plot([low, high], [at, at], color=INK, lw=1.3, zorder=4, clip_on=False)
        panel.plot(
            [low, high],
            [at, at],
            ls="",
            marker="|",
            ms=6,
            color=INK,
            mew=1.3,
            zorder=4,
            clip_on=False,
        )
        seeds = row.pc_success_by_seed or {}
        if len(seeds) > 1:
            dots: dict[str, Any] = {
                "s": 13,
                "color": "white",
                "edgecolors": INK,
                "lw": 0.8,
                "clip_on": False,
            }
            panel.scatter(list(seeds.values()), [at + 0.2] * len(seeds), zorder=5, **dots)
        panel.text(104, at, f"{row.pc_success:.0f}", va="center", fontweight="bold")
        panel.text(117, at, f"[{low:.0f}, {high:.0f}]", va="center", fontsize=8, color=MUTED)
    panel.set_yticks(range(len(methods)), methods)
    panel.set_ylim(len(methods) - 0.45, -0.55)
    panel.set_xlim(0, 100)
    panel.set_xticks([0, 25, 50, 75, 100])
    panel.grid(axis="x", color=FAINT, lw=0.6, zorder=0)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    counts = sorted({row.n_episodes for row in rows})
    episodes = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    seeds_shown = any(len(row.pc_success_by_seed or {}) > 1 for row in rows)
    dots_text = "; dots: training seeds" if seeds_shown else ""
    label = f"success %, 95 % interval, {episodes} episodes{dots_text}"
    panel.set_xlabel(label, fontsize=8)


# --- frames --------------------------------------------------------------------------------------


def film_strip(
    frames: Frames, goal: Frame, path: Path, *, caption: str = "", every: int | None = None
) -> None:
    """An episode as a PNG: every `every`-th frame and the last, then the goal.

    Args:
        frames: [T, H, W, 3] u8, the reset frame first.
        goal: [H, W, 3] u8.
        path: where the PNG goes.
        caption: a line above it.
        every: by default as many as give two rows of ten at most.
    """
    stride = every or max(1, -(-len(frames) // 18))
    steps = sorted({*range(0, len(frames), stride), len(frames) - 1})
    rows, columns = grid_shape(len(steps) + 1, most=10)
    images = [*(frames[step] for step in steps), goal]
    labels = [*(f"step {step}" for step in steps), "goal"]
    colours = [START, *[FAINT] * (len(steps) - 1), GOAL]
    with figure_png(path, 0.2 + 1.02 * columns, 0.1 + 1.2 * rows + 0.3 * bool(caption)) as figure:
        place = figure.add_gridspec(1, 1)[0]
        frame_grid(figure, place, images, labels=labels, colours=colours, columns=columns)
        if caption:
            figure.suptitle(caption, x=0.01, ha="left", fontsize=10, fontweight="bold")


def reconstruction_strip(
    images: Frames, reconstructions: Frames, path: Path, *, labels: Sequence[object]
) -> None:
    """Images as a PNG row, each above what an autoencoder makes of it.

    Args:
        images: [N, H, W, 3] u8.
        reconstructions: [N, H', W', 3] u8.
        path: where the PNG goes.
        labels: which episode each image is of.
    """
    columns = len(images)
    with figure_png(path, 0.2 + 1.02 * columns, 2.5) as figure:
        frame_grid(
            figure,
            figure.add_gridspec(1, 1)[0],
            [*images, *reconstructions],
            labels=[*(f"episode {label}" for label in labels), *["reconstructed"] * columns],
            colours=[FAINT] * (2 * columns),
            columns=columns,
        )


def animation(
    frames: Frames,
    goal: Frame,
    path: Path,
    *,
    caption: str = "",
    success_step: int | None = None,
    scale: int = 4,
    fps: int = 10,
) -> None:
    """An episode as a GIF: the frame beside the goal, a green border from `success_step` on.

    Args:
        frames: [T, H, W, 3] u8, the reset frame first.
        goal: [H, W, 3] u8.
        path: where the GIF goes.
        caption: a line above it.
        success_step: index of the first frame inside the success radius.
        scale: pixels a side that one pixel becomes.
        fps: frames a second; the last one stays for 1.5 s.
    """
    from PIL import Image

    canvases = [
        _canvas(
            frame,
            goal,
            scale=scale,
            text=f"{caption}   step {step}".strip(),
            reached=success_step is not None and step >= success_step,
        )
        for step, frame in enumerate(frames)
    ]
    palette = _common_palette(canvases)
    first, *rest = [
        canvas.quantize(palette=palette, dither=Image.Dither.NONE) for canvas in canvases
    ]
    durations = [1000 // fps] * (len(canvases) - 1) + [1500]
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=durations, loop=0)


def _canvas(frame: Frame, goal: Frame, *, scale: int, text: str, reached: bool) -> Image.Image:
    """One picture of the animation: a line of text, the frame, the goal."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = frame.shape[0] * scale, frame.shape[1] * scale
    margin, header = 3 * scale, 7 * scale
    canvas = Image.new("RGB", (2 * width + 4 * margin, height + header + margin), "white")
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(3.5 * scale)
    border = START if reached else FAINT
    sides = ((margin, frame, border, text), (width + 3 * margin, goal, GOAL, "goal"))
    for left, image, colour, label in sides:
        box = (left - scale, header - scale, left + width + scale - 1, header + height + scale - 1)
        draw.rectangle(box, fill=colour)
        big = Image.fromarray(np.ascontiguousarray(image)).resize(
            (width, height), Image.Resampling.NEAREST
        )
        canvas.paste(big, (left, header))
        draw.text((left - scale, scale), label, fill=INK, font=font)
    return canvas


def _common_palette(canvases: Sequence[Image.Image]) -> Image.Image:
    """One palette for all pictures, so that only what moves costs bytes."""
    from PIL import Image

    chosen = [canvases[at] for at in sorted({0, len(canvases) // 2, len(canvases) - 1})]
    width, height = chosen[0].size
    sheet = Image.new("RGB", (width, height * len(chosen)))
    for at, canvas in enumerate(chosen):
        sheet.paste(canvas, (0, at * height))
    return sheet.quantize(colors=128, method=Image.Quantize.MEDIANCUT)


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
    """Frames in rows of `columns`, each with a border and a label under it."""
    rows = -(-len(images) // columns)
    grid = place.subgridspec(rows, columns, wspace=0.08, hspace=0.0)
    for at, (image, label, colour) in enumerate(zip(images, labels, colours, strict=True)):
        cell = figure.add_subplot(grid[at // columns, at % columns])
        cell.imshow(image, interpolation="nearest")
        cell.set_xticks([])
        cell.set_yticks([])
        plain = colour == FAINT
        cell.spines[:].set(color=colour, linewidth=0.8 if plain else 2.2)
        weight = "normal" if plain else "bold"
        shade = MUTED if plain else colour
        cell.set_xlabel(label, fontsize=8, color=shade, fontweight=weight, labelpad=3)


# --- canvas --------------------------------------------------------------------------------------


@contextmanager
def figure_png(path: Path, width: float, height: float) -> Iterator[Figure]:
    """A white figure of `width` x `height` inches, written to `path` as a PNG at the end.

    The user's own matplotlib settings are left out, and so are time and version stamps.
    """
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style.context(["default", _STYLE]):
        figure = Figure(figsize=(width, height), dpi=150, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        yield figure
        figure.savefig(path, format="png", metadata={"Software": None})
