"""Rectangles in the unit square: their lengths, and layouts that stand for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from elast_cli.envs.scenario import Vector
from elast_cli.errors import ConfigError


def _ordered(rect: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if rect[0] > rect[2] or rect[1] > rect[3]:
        raise ValueError("a rectangle reads x_min, y_min, x_max, y_max")
    return rect


Side = Annotated[float, Field(ge=-1, le=2)]  # of a rectangle, near the unit square
Rect = Annotated[tuple[Side, Side, Side, Side], AfterValidator(_ordered)]
_DIGITS = 6  # decimals that single precision keeps of a length in the unit square


def layout_of(rects: Sequence[Rect]) -> Vector:
    """The layout f32 [4 M] that stands for M rectangles."""
    return np.array(rects, dtype=np.float32).ravel()


def rects_of(layout: Vector, *, count: int) -> tuple[Rect, ...]:
    """The rectangles that a layout f32 [4 count] stands for, in workspace widths.

    Raises:
        ValueError: if it stands for another number of them, or for no rectangles at all.
    """
    corners = np.round(np.asarray(layout, dtype=np.float64), _DIGITS)
    if corners.shape != (4 * count,):
        raise ValueError(f"layout of shape {corners.shape}: expected {4 * count} numbers")
    rects = corners.reshape(count, 4)
    if not (rects[:, :2] < rects[:, 2:]).all():
        raise ValueError(f"layout {corners.tolist()}: each four must be x_min, y_min, x_max, y_max")
    return tuple((a, b, c, d) for a, b, c, d in rects.tolist())


def count_cells(length: float, cell: float) -> int:
    """How many cells a length has. Raises ConfigError: no whole number."""
    count = round(length / cell)
    if abs(length / cell - count) > 1e-3:
        raise ConfigError(f"length {length:g} is not a multiple of the lattice cell {cell:g}")
    return count


def check_range(name: str, bounds: tuple[float, float]) -> None:
    """Raise ValueError unless the bounds of a random length are positive, the least first."""
    if not 0 < bounds[0] <= bounds[1]:
        raise ValueError(f"{name}: {bounds}: two positive lengths, the least first")


def check_lanes(thickness: tuple[float, float], lane: float) -> None:
    """Raise ValueError unless any two walls leave three lanes of the least size."""
    check_range("thickness", thickness)
    if 2 * thickness[1] + 3 * lane > 1:
        raise ValueError("two walls of the greatest thickness and three lanes exceed the workspace")


def check_cells(name: str, lengths: Iterable[float], cell: float) -> None:
    """Raise ValueError unless lengths are multiples of a lattice cell.

    Args:
        name: of the setting, for errors.
        lengths: in workspace widths.
        cell: length of a lattice cell.
    """
    try:
        for length in lengths:
            count_cells(length, cell)
    except ConfigError as wrong:
        raise ValueError(f"{name}: {wrong}") from None


def whole_cells(rng: np.random.Generator, low: float, high: float, *, cell: float) -> float:
    """A random multiple of `cell` in [low, high], each equally likely; both are multiples.

    Args:
        rng: draws the number of cells.
        low: least value.
        high: greatest value.
        cell: length of a cell, in the same unit.
    """
    return round(int(rng.integers(round(low / cell), round(high / cell) + 1)) * cell, _DIGITS)
