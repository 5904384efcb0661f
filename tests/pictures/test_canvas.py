"""Colours of methods and rows of frames."""

from __future__ import annotations

import pytest

from elast_cli.pictures.canvas import METHOD_COLOURS, colour_of, grid_shape


def test_each_method_has_a_colour_of_its_own() -> None:
    assert len(set(METHOD_COLOURS.values())) == len(METHOD_COLOURS)
    assert colour_of("elast") == METHOD_COLOURS["elast"]


def test_an_ablation_has_its_base_in_a_lighter_tone() -> None:
    light = colour_of("elast-psi-no-rewire")
    assert light == colour_of("elast-psi-no-density")
    assert light not in (*METHOD_COLOURS.values(), colour_of("elast-no-rewire"))
    assert colour_of("something-else") == colour_of("another")


@pytest.mark.parametrize(
    ("count", "shape"), [(1, (1, 1)), (10, (1, 10)), (11, (2, 6)), (19, (2, 10)), (21, (3, 7))]
)
def test_rows_of_frames_are_about_equally_long(count: int, shape: tuple[int, int]) -> None:
    assert grid_shape(count, most=10) == shape
