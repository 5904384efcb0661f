"""Image files that a user names, as frames u8 [64,64,3]; any of them may be made to do harm."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.errors import DataError
from elast_cli.files import one_line, read_regular
from elast_cli.shapes import IMAGE_SIZE, Float64, Uint8

if TYPE_CHECKING:
    from PIL import Image

FORMATS = ("PNG", "JPEG", "BMP", "PPM")
MAX_BYTES = 64 << 20
MAX_PIXELS = 1 << 25  # 33 million, more than a camera has that one would plan with
_STRIP = 256  # rows that are averaged at once
_UNREADABLE = (  # what Pillow raises at damaged files
    OSError,
    ValueError,
    SyntaxError,
    EOFError,
    TypeError,
    LookupError,
    OverflowError,
    struct.error,
    zlib.error,
)


def read_image(path: str | Path) -> Uint8:
    """The picture in a file, averaged over areas to a frame u8 [64,64,3].

    A picture that is not square is squeezed. Rotations that a camera noted are applied. Colours may
    come from a palette; a channel of opacity must be opaque everywhere.

    Raises:
        MissingInputError: there is no such file.
        DataError: no image of these formats, damaged, too large, or grey, transparent or of
            another colour space.
        StorageError: the disk fails.
    """
    path = Path(path)
    content = read_regular(path, error=DataError, max_bytes=MAX_BYTES)
    from PIL import Image, ImageOps, UnidentifiedImageError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's of large images: the limit here is lower
        try:
            with Image.open(io.BytesIO(content), formats=FORMATS) as image:
                _refuse_large(image, path)
                image.load()
                ImageOps.exif_transpose(image, in_place=True)
                return area_average(_coloured(image, path))
        except (UnidentifiedImageError, Image.DecompressionBombError) as reason:
            large = isinstance(reason, Image.DecompressionBombError)
            what = "too many pixels" if large else f"not an image ({', '.join(FORMATS)})"
            raise DataError(f"{path}: {what}") from None
        except _UNREADABLE as reason:
            raise DataError(f"{path}: a damaged image: {one_line(reason)}") from None


def _refuse_large(image: Image.Image, path: Path) -> None:
    """Raise DataError if an image has too many pixels; none of them is read yet."""
    width, height = image.size
    if width * height > MAX_PIXELS:
        raise DataError(
            f"{path}: {width} x {height} pixels, at most {MAX_PIXELS} are read; make it smaller"
        )


def _coloured(image: Image.Image, path: Path) -> Image.Image:
    """An image in RGB. Raises DataError if that is not clear."""
    if image.mode == "P":
        image = image.convert("RGBA" if "transparency" in image.info else "RGB")
    if image.mode == "RGBA":
        if image.getchannel("A").getextrema()[0] != 255:
            raise DataError(f"{path}: it has transparent pixels; save it with a background")
        image = image.convert("RGB")
    if image.mode != "RGB" or "transparency" in image.info:
        raise DataError(f"{path}: of mode {image.mode}, not RGB; convert it to 8-bit RGB")
    return image


def area_average(image: Image.Image) -> Uint8:
    """An RGB image of any size as [64,64,3]: each pixel is the mean over its area."""
    width, height = image.size
    total = np.zeros((IMAGE_SIZE, IMAGE_SIZE, 3))
    across, down = _shares(width), _shares(height)
    for top in range(0, height, _STRIP):
        strip = np.asarray(image.crop((0, top, width, min(top + _STRIP, height))))
        narrow = np.einsum("xw,hwc->hxc", across, strip.astype(np.float64), optimize=True)
        rows = down[:, top : top + len(strip)]
        total += np.einsum("yh,hxc->yxc", rows, narrow, optimize=True)
    rounded: Uint8 = np.clip(np.floor(total + 0.5), 0, 255).astype(np.uint8)
    return rounded


def _shares(size: int) -> Float64:
    """How much of each of 64 equal parts of a side is which of its `size` pixels: [64,size]."""
    edges = np.arange(IMAGE_SIZE + 1) * (size / IMAGE_SIZE)
    pixel = np.arange(size)
    covered = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    shares: Float64 = np.clip(covered, 0, None) / (size / IMAGE_SIZE)
    return shares
