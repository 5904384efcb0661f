"""Film strips and animations of episodes, and strips of reconstructions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.pictures.canvas import (
    FAINT,
    GOAL,
    INK,
    START,
    Frame,
    Frames,
    figure_png,
    frame_grid,
    grid_shape,
)

if TYPE_CHECKING:
    from PIL import Image


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


def reconstruction_grid(
    images: Frames, decoded: Mapping[str, Frames], path: Path, *, labels: Sequence[str]
) -> None:
    """Images as a PNG row, above rows of what a model makes of them.

    Args:
        images: [N, H, W, 3] u8.
        decoded: [N, H', W', 3] u8 for each row below, by its label.
        path: where the PNG goes.
        labels: one an image.
    """
    columns, rows = len(images), 1 + len(decoded)
    with figure_png(path, 0.2 + 1.02 * columns, 0.1 + 1.2 * rows) as figure:
        frame_grid(
            figure,
            figure.add_gridspec(1, 1)[0],
            [*images, *(frame for row in decoded.values() for frame in row)],
            labels=[*labels, *(label for label in decoded for _ in range(columns))],
            colours=[FAINT] * (rows * columns),
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

    pictures = [
        _side_by_side(
            frame,
            goal,
            scale=scale,
            text=f"{caption}   step {step}".strip(),
            reached=success_step is not None and step >= success_step,
        )
        for step, frame in enumerate(frames)
    ]
    palette = _common_palette(pictures)
    first, *rest = [
        picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures
    ]
    durations = [1000 // fps] * (len(pictures) - 1) + [1500]
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=durations, loop=0)


def _side_by_side(
    frame: Frame, goal: Frame, *, scale: int, text: str, reached: bool
) -> Image.Image:
    """One picture of the animation: a line of text, the frame, the goal."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = frame.shape[0] * scale, frame.shape[1] * scale
    margin, header = 3 * scale, 7 * scale
    picture = Image.new("RGB", (2 * width + 4 * margin, height + header + margin), "white")
    draw = ImageDraw.Draw(picture)
    size, room = 3.5 * scale, width + margin
    wide = ImageFont.load_default(size).getlength(text)
    font = ImageFont.load_default(size * min(1, room / max(wide, 1)))
    border = START if reached else FAINT
    sides = ((margin, frame, border, text), (width + 3 * margin, goal, GOAL, "goal"))
    for left, image, colour, label in sides:
        box = (left - scale, header - scale, left + width + scale - 1, header + height + scale - 1)
        draw.rectangle(box, fill=colour)
        big = Image.fromarray(np.ascontiguousarray(image)).resize(
            (width, height), Image.Resampling.NEAREST
        )
        picture.paste(big, (left, header))
        draw.text((left - scale, scale), label, fill=INK, font=font)
    return picture


def _common_palette(pictures: Sequence[Image.Image]) -> Image.Image:
    """One palette for all pictures, so that only what moves costs bytes."""
    from PIL import Image

    chosen = [pictures[at] for at in sorted({0, len(pictures) // 2, len(pictures) - 1})]
    width, height = chosen[0].size
    sheet = Image.new("RGB", (width, height * len(chosen)))
    for at, image in enumerate(chosen):
        sheet.paste(image, (0, at * height))
    return sheet.quantize(colors=128, method=Image.Quantize.MEDIANCUT)
