"""Frames to draw, and what a picture on disk shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def moving_square(count: int = 12) -> NDArray[np.uint8]:
    """Frames u8 [T,64,64,3] of a red square that moves to the right."""
    frames = np.full((count, 64, 64, 3), 240, dtype=np.uint8)
    for step, frame in enumerate(frames):
        frame[20:30, 2 + 4 * step : 12 + 4 * step] = (220, 60, 40)
    return frames


def pixels(path: Path) -> NDArray[np.uint8]:
    """The picture u8 [H,W,3]."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def shows(image: NDArray[np.uint8], colour: str, *, at_least: int = 50) -> bool:
    """Whether that many pixels have a colour, such as `#1f2430`."""
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
    return int((np.abs(image.astype(int) - wanted).max(axis=-1) <= 12).sum()) >= at_least
