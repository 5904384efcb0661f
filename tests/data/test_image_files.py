"""Image files of users: any size becomes a frame; what is no plain picture is refused."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from elast_cli.data.image_files import MAX_BYTES, MAX_PIXELS, read_image
from elast_cli.errors import DataError, MissingInputError
from elast_cli.shapes import Uint8
from tests.toys.hostile import bounded


@pytest.fixture
def noise() -> Uint8:
    return np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)


def saved(path: Path, pixels: Uint8, mode: str = "RGB") -> Path:
    Image.fromarray(pixels).convert(mode).save(path)
    return path


@pytest.mark.parametrize("name", ["a.png", "a.bmp", "a.ppm"])
def test_a_frame_is_read_as_it_is(tmp_path: Path, noise: Uint8, name: str) -> None:
    np.testing.assert_array_equal(read_image(saved(tmp_path / name, noise)), noise)


@pytest.mark.parametrize("factors", [(3, 3), (2, 5), (1, 4)])
def test_a_whole_multiple_is_averaged_back(
    tmp_path: Path, noise: Uint8, factors: tuple[int, int]
) -> None:
    large = noise.repeat(factors[0], 0).repeat(factors[1], 1)
    np.testing.assert_array_equal(read_image(saved(tmp_path / "a.png", large)), noise)


def test_pixels_count_by_the_area_that_they_cover(tmp_path: Path) -> None:
    stripes = np.zeros((96, 96, 3), np.uint8)  # one and a half pixels each
    stripes[:, ::3] = 90
    found = read_image(saved(tmp_path / "a.png", stripes))
    np.testing.assert_array_equal(found[:, ::2], 60)  # 90 * 1 / 1.5
    np.testing.assert_array_equal(found[:, 1::2], 0)
    small = np.zeros((2, 1, 3), np.uint8)
    small[1] = 200
    found = read_image(saved(tmp_path / "b.png", small))
    assert (found[:32] == 0).all()
    assert (found[32:] == 200).all()


def test_palettes_opaque_channels_and_rotations_are_understood(tmp_path: Path) -> None:
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:16, :16] = (255, 0, 0)
    image = Image.fromarray(pixels)
    image.convert("P").save(tmp_path / "palette.png")
    image.convert("RGBA").save(tmp_path / "opaque.png")
    for name in ("palette.png", "opaque.png"):
        np.testing.assert_array_equal(read_image(tmp_path / name), pixels)
    exif = Image.Exif()
    exif[0x0112] = 3  # turned upside down
    image.save(tmp_path / "turned.png", exif=exif)
    np.testing.assert_array_equal(read_image(tmp_path / "turned.png"), pixels[::-1, ::-1])


def transparent(path: Path, pixels: Uint8) -> None:
    alpha = np.full((64, 64, 1), 255, np.uint8)
    alpha[3, 4] = 254
    Image.fromarray(np.concatenate([pixels, alpha], 2), "RGBA").save(path)


def bomb(path: Path, width: int, height: int) -> None:
    """A small PNG that says it is large."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))
        )

    head = chunk(b"IHDR", struct.pack(">LLBBBBB", width, height, 8, 2, 0, 0, 0))
    data = chunk(b"IDAT", zlib.compress(b"\0" * 1_000_000))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + data + chunk(b"IEND", b""))


def cut(path: Path, pixels: Uint8) -> None:
    saved(path, pixels)
    path.write_bytes(path.read_bytes()[:2000])


def pickled(path: Path, pixels: Uint8) -> None:
    with path.open("wb") as file:
        np.save(file, np.array([{"a": 1}]), allow_pickle=True)


def other_format(path: Path, pixels: Uint8) -> None:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "GIF")
    path.write_bytes(buffer.getvalue())


HARM: dict[str, tuple[Callable[[Path, Uint8], object], str | None]] = {
    "grey": (lambda path, x: saved(path, x, "L"), "of mode L, not RGB"),
    "one bit": (lambda path, x: saved(path, x, "1"), "of mode 1, not RGB"),
    "grey with opacity": (lambda path, x: saved(path, x, "LA"), "of mode LA, not RGB"),
    "transparent": (transparent, "transparent pixels"),
    "text": (lambda path, x: path.write_text("hello"), r"not an image \(PNG, JPEG"),
    "nothing": (lambda path, x: path.write_bytes(b""), "not an image"),
    "a pickle": (pickled, "not an image"),
    "another format": (other_format, "not an image"),
    "cut short": (cut, "a damaged image"),
    "many pixels": (lambda path, x: bomb(path, 6000, 6000), f"at most {MAX_PIXELS}"),
    "very many pixels": (lambda path, x: bomb(path, 1 << 30, 1 << 30), "too many pixels"),
    "no pixels": (lambda path, x: bomb(path, 0, 64), None),
    "many bytes": (lambda path, x: os.truncate(saved(path, x), MAX_BYTES + 1), "larger than"),
    "a pipe": (lambda path, x: os.mkfifo(path), "not a regular file"),
    "a folder": (lambda path, x: path.mkdir(), None),
}


@pytest.mark.parametrize("case", HARM)
def test_what_is_no_picture_is_refused_in_one_line(tmp_path: Path, noise: Uint8, case: str) -> None:
    harm, message = HARM[case]
    path = tmp_path / "a.png"
    harm(path, noise)
    with bounded(), pytest.raises(DataError, match=message) as caught:
        read_image(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_picture_at_the_limit_costs_little(tmp_path: Path) -> None:
    side = int(MAX_PIXELS**0.5)
    Image.new("RGB", (side, side), (1, 2, 3)).save(tmp_path / "a.png", compress_level=1)
    with bounded():
        found = read_image(tmp_path / "a.png")
    assert (found == (1, 2, 3)).all()


def test_a_file_that_is_not_there_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError, match="no such file"):
        read_image(tmp_path / "none.png")
