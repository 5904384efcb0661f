"""Anti-aliased shapes on 64x64 images of the unit square; row 0 is the top (y = 1)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from elast_cli.compiled import njit
from elast_cli.envs.flat.rectangles import Rect
from elast_cli.shapes import IMAGE_SIZE

Colour = tuple[float, float, float]
Floats = NDArray[np.float64]

BACKGROUND = (244.0, 243.0, 238.0)
WALL = (52.0, 58.0, 70.0)


def empty(rects: tuple[Rect, ...], colour: Colour = WALL) -> Floats:
    """The background with some rectangles on it, f64 [64, 64, 3]."""
    image = np.full((IMAGE_SIZE, IMAGE_SIZE, 3), BACKGROUND)
    for rect in rects:
        rows, columns, patch = rectangle(image, rect, colour)
        image[rows, columns] = patch
    return image


def rectangle(image: Floats, rect: Rect, colour: Colour) -> tuple[slice, slice, Floats]:
    """Rows, columns and content [h, w, 3] of `image` where a rectangle is painted over it.

    A pixel takes as much of the colour as the rectangle covers of it: exact, both are axis-aligned.

    Args:
        image: f64 [64, 64, 3], left as it is.
        rect: in workspace widths.
        colour: RGB, 0 to 255.

    Returns:
        Slices of rows and columns, and f64 [h, w, 3].
    """
    columns, across = _coverage(rect[0] * IMAGE_SIZE, rect[2] * IMAGE_SIZE)
    rows, down = _coverage((1 - rect[3]) * IMAGE_SIZE, (1 - rect[1]) * IMAGE_SIZE)
    below = image[rows, columns]
    share = (down[:, None] * across)[:, :, None]
    return rows, columns, below + share * (np.asarray(colour) - below)


def _coverage(low: float, high: float) -> tuple[slice, Floats]:
    """Pixels that the interval [low, high] touches, and the covered share of each."""
    first = min(max(math.floor(low), 0), IMAGE_SIZE)
    last = max(min(math.ceil(high), IMAGE_SIZE), first)
    share = [1.0] * (last - first)
    if share:  # only the first and the last can be covered in part
        share[0] = min(first + 1, high) - max(first, low)
        share[-1] = min(last, high) - max(last - 1, low)
    return slice(first, last), np.array(share)


@njit()
def _nearest(px: float, py: float, ux: float, uy: float, square: float) -> tuple[float, float]:
    """Share of the way from the origin to (ux, uy) that is nearest a place, and its distance."""
    part = min(max((px * ux + py * uy) / square, 0.0), 1.0)
    return part, np.hypot(px - part * ux, py - part * uy)


@njit()
def capsules(image: Floats, ends: Floats, radii: Floats, colours: Floats) -> Floats:
    """`image` f64 [64, 64, 3] with round lines over it, the later above: f64 [64, 64, 3].

    Line k leads from `ends[k, :2]` to `ends[k, 2:]` (a disc where they are equal) and has its own
    radius and colour [3]. Its edge is as soft as that of a `chain`.

    Args:
        image: f64 [64, 64, 3], left as it is.
        ends: (x, y) of both ends f64 [K, 4], in workspace widths.
        radii: f64 [K], in workspace widths.
        colours: RGB f64 [K, 3], 0 to 255.
    """
    size = image.shape[0]
    painted = image.copy()
    for k in range(ends.shape[0]):
        ax, ay = ends[k, 0] * size, (1 - ends[k, 1]) * size
        ux, uy = ends[k, 2] * size - ax, (1 - ends[k, 3]) * size - ay
        square = max(ux * ux + uy * uy, 1e-12)
        reach = radii[k] * size + 1.0
        for row in range(
            max(int(min(ay, ay + uy) - reach), 0), min(int(max(ay, ay + uy) + reach) + 1, size)
        ):
            for column in range(
                max(int(min(ax, ax + ux) - reach), 0), min(int(max(ax, ax + ux) + reach) + 1, size)
            ):
                gap = _nearest(column + 0.5 - ax, row + 0.5 - ay, ux, uy, square)[1]
                cover = min(max(radii[k] * size + 0.5 - gap, 0.0), 1.0)
                for c in range(3):
                    painted[row, column, c] += cover * (colours[k, c] - painted[row, column, c])
    return painted


@njit()
def chain(
    image: Floats, nodes: Floats, radius: float, head_radius: float, colours: Floats
) -> NDArray[np.uint8]:
    """`image` f64 [64, 64, 3] with a line through `nodes` f64 [N, 2] over it, u8 [64, 64, 3].

    Lengths are in workspace widths. `colours` f64 [3, 3] are RGB, 0 to 255: of the line at its
    first and last node, and of a disc at the first. Edges fade linearly over the width of a pixel.
    """
    size = image.shape[0]
    share, along = np.zeros((size, size)), np.zeros((size, size))
    last = nodes.shape[0] - 1
    for k in range(last):
        ax, ay = nodes[k, 0] * size, (1 - nodes[k, 1]) * size
        ux, uy = nodes[k + 1, 0] * size - ax, (1 - nodes[k + 1, 1]) * size - ay
        square = max(ux * ux + uy * uy, 1e-12)
        reach = radius * size + 1.0
        for row in range(
            max(int(min(ay, ay + uy) - reach), 0), min(int(max(ay, ay + uy) + reach) + 1, size)
        ):
            for column in range(
                max(int(min(ax, ax + ux) - reach), 0), min(int(max(ax, ax + ux) + reach) + 1, size)
            ):
                part, gap = _nearest(column + 0.5 - ax, row + 0.5 - ay, ux, uy, square)
                cover = min(max(radius * size + 0.5 - gap, 0.0), 1.0)
                if cover > share[row, column]:
                    share[row, column] = cover
                    along[row, column] = (k + part) / last
    hx, hy = nodes[0, 0] * size, (1 - nodes[0, 1]) * size
    frame = np.empty(image.shape, dtype=np.uint8)
    for row in range(size):
        for column in range(size):
            gap = np.hypot(column + 0.5 - hx, row + 0.5 - hy)
            disc = min(max(head_radius * size + 0.5 - gap, 0.0), 1.0)
            for c in range(3):
                line = colours[0, c] + along[row, column] * (colours[1, c] - colours[0, c])
                value = image[row, column, c]
                value += share[row, column] * (line - value)
                value += disc * (colours[2, c] - value)
                frame[row, column, c] = np.uint8(np.round(value))
    return frame
