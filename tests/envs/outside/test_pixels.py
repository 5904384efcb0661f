"""Area averages: against sums by hand, and laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from elast_cli.envs.outside.pixels import averaged, checked, coarse
from elast_cli.errors import DataError


def test_whole_blocks_are_averaged() -> None:
    image = np.random.default_rng(0).integers(0, 256, (128, 192, 3), np.uint8)
    means = image.reshape(64, 2, 64, 3, 3).mean((1, 3))
    assert np.abs(averaged(image) - means).max() <= 0.5 + 1e-4


def test_a_pixel_that_two_share_counts_by_its_area() -> None:
    image = np.zeros((64, 96, 3), np.uint8)  # each of 64 columns covers one and a half of 96
    image[:, 1] = 240
    found = averaged(image)
    assert found[:, 0].min() == found[:, 1].max() == 80  # half a column of one and a half
    assert not found[:, 2:].any()


def test_a_small_image_grows() -> None:
    image = np.zeros((32, 16, 3), np.uint8)
    image[3, 5] = (9, 90, 200)
    found = averaged(image)
    assert (found[6:8, 20:24] == (9, 90, 200)).all()
    assert found.astype(int).sum() == 8 * 299


@given(st.integers(1, 200), st.integers(1, 200), st.integers(0, 255))
def test_one_colour_stays_the_same(height: int, width: int, colour: int) -> None:
    found = averaged(np.full((height, width, 3), colour, np.uint8))
    assert found.shape == (64, 64, 3)
    assert (found == colour).all()


def test_a_frame_of_the_right_size_is_copied() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 64, 3), np.uint8)
    found = averaged(image)
    assert np.array_equal(found, image)
    assert not np.shares_memory(found, image)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (None, "NoneType"),
        (np.zeros((8, 8, 3)), r"float64 \[8, 8, 3\]"),
        (np.zeros((8, 8), np.uint8), r"uint8 \[8, 8\]"),
        (np.zeros((8, 8, 4), np.uint8), r"uint8 \[8, 8, 4\]"),
        (np.zeros((0, 8, 3), np.uint8), r"uint8 \[0, 8, 3\]"),
    ],
)
def test_what_is_no_image_is_described(image: object, words: str) -> None:
    with pytest.raises(DataError, match=rf"Env-v0: the goal is {words}; expected uint8"):
        checked(image, "Env-v0", "the goal")


def test_coarse_averages_lie_between_0_and_1() -> None:
    image = np.zeros((64, 64, 3), np.uint8)
    image[:4, 4:8, 1] = 255
    found = coarse(image)
    assert found[0, 1, 1] == 1
    assert found.sum() == 1
