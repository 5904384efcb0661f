"""Frames of any size to 64x64 by area averaging, and to what success compares."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy import sparse

from elast_cli.envs.scenario import Frame
from elast_cli.errors import DataError
from elast_cli.shapes import IMAGE_SIZE

COARSE = 16  # pixels a side of the averages that are compared


def checked(image: object, env_id: str, what: str) -> Frame:
    """An image of outside code, unchanged: uint8 [height, width, 3].

    Raises:
        DataError: it is something else.
    """
    if not isinstance(image, np.ndarray):
        found = type(image).__name__
    elif image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        found = f"{image.dtype} {list(image.shape)}"
    else:
        return image
    raise DataError(f"{env_id}: {what} is {found}; expected uint8 [height, width, 3]")


def averaged(image: Frame) -> Frame:
    """An image u8 [H, W, 3] as u8 [64, 64, 3]: every pixel is the mean of the area it covers.

    The sides are scaled separately, so an image that is not square is squeezed. Always a new array.
    """
    height, width, _ = image.shape
    if (height, width) == (IMAGE_SIZE, IMAGE_SIZE):
        return image.copy()
    lines = _shares(height) @ image.reshape(height, -1).astype(np.float32)  # [64, W * 3]
    turned = lines.reshape(IMAGE_SIZE, width, 3).transpose(1, 0, 2).reshape(width, -1)
    columns = (_shares(width) @ turned).reshape(IMAGE_SIZE, IMAGE_SIZE, 3)
    whole: Frame = np.rint(columns.transpose(1, 0, 2)).astype(np.uint8)
    return np.ascontiguousarray(whole)


@cache
def _shares(size: int) -> sparse.csr_array:
    """The share f32 [64, size] that each of `size` pixels has in each of 64."""
    edges = np.arange(size + 1) * (IMAGE_SIZE / size)
    first = np.arange(IMAGE_SIZE)[:, None]
    shared = np.minimum(edges[1:], first + 1) - np.maximum(edges[:-1], first)
    return sparse.csr_array(np.clip(shared, 0, None).astype(np.float32))


def coarse(frame: Frame) -> np.ndarray:
    """A frame u8 [64, 64, 3] averaged to f64 [16, 16, 3] in [0, 1]."""
    cell = IMAGE_SIZE // COARSE
    sums = frame.reshape(COARSE, cell, COARSE, cell, 3).sum((1, 3), dtype=np.int64)
    found: np.ndarray = sums / (255.0 * cell * cell)
    return found
