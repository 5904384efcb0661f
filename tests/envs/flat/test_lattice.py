"""Shortest steps of a point among rectangles."""

from __future__ import annotations

import numpy as np
import pytest

from elast_cli.envs.flat.lattice import Lattice
from elast_cli.envs.flat.shortest_path import UNREACHABLE
from elast_cli.errors import ConfigError


def test_shortest_steps_on_an_open_field_are_those_of_the_larger_axis() -> None:
    open_field = Lattice([], low=0.05, high=0.95, step=0.07, cell=0.005)
    field = open_field.field(np.array([0.5, 0.5]), 0.05)
    assert open_field.steps(field, np.array([0.5, 0.54])) == 0
    assert open_field.steps(field, np.array([0.5, 0.62])) == 1
    assert open_field.steps(field, np.array([0.5, 0.625])) == 2
    assert open_field.steps(field, np.array([0.9, 0.5])) == 5
    assert open_field.steps(field, np.array([0.9, 0.9])) == 6  # the disc's edge is nearer in x


def test_a_place_behind_closed_walls_cannot_be_reached() -> None:
    shut = Lattice([(0.0, 0.4, 1.0, 0.6)], low=0.05, high=0.95, step=0.07, cell=0.01)
    field = shut.field(np.array([0.5, 0.8]), 0.05)
    assert shut.steps(field, np.array([0.5, 0.2])) == UNREACHABLE


def test_walls_off_the_lattice_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"0\.333"):
        Lattice([(0.0, 0.333, 1.0, 0.6)], low=0.0, high=1.0, step=0.07, cell=0.01)


def test_shortest_steps_count_the_drift() -> None:
    band = Lattice(
        [], low=0.05, high=0.95, step=0.07, cell=0.005, stream=(0.0, 0.3, 1.0, 0.7), drift=(0, -0.1)
    )
    field = band.field(np.array([0.5, 0.2]), 0.05)
    assert band.steps(field, np.array([0.5, 0.7])) == 3  # 0.17 a step down the stream
    assert band.steps(field, np.array([0.5, 0.9])) == 6  # three steps into it, then three
    up = band.field(np.array([0.5, 0.9]), 0.05)
    assert band.steps(up, np.array([0.5, 0.2])) == UNREACHABLE
    assert band.steps(up, np.array([0.5, 0.69])) == UNREACHABLE


def test_a_sideways_stream_is_counted_as_well() -> None:
    band = Lattice(
        [], low=0.05, high=0.95, step=0.07, cell=0.005, stream=(0.0, 0.4, 1.0, 0.6), drift=(0.1, 0)
    )
    field = band.field(np.array([0.8, 0.5]), 0.05)
    assert band.steps(field, np.array([0.25, 0.5])) == 3
    assert band.steps(band.field(np.array([0.25, 0.5]), 0.05), np.array([0.8, 0.5])) > 6
