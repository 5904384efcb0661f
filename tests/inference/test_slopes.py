"""Exact slopes of networks, against those that torch finds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from elast_cli.inference.slopes import MeanSlopes
from elast_cli.shapes import Float32

ROWS, INPUTS, OUTPUTS = 7, 6, 5


def layers(widths: list[int], members: int, seed: int = 0) -> list[tuple[Float32, Float32]]:
    """Weights [E,in,out] and biases [E,out]."""
    rng = np.random.default_rng(seed)
    sizes = [INPUTS, *widths, OUTPUTS]
    return [
        (
            rng.normal(size=(members, n_in, n_out)).astype(np.float32),
            rng.normal(size=(members, n_out)).astype(np.float32),
        )
        for n_in, n_out in itertools.pairwise(sizes)
    ]


def by_torch(net: list[tuple[Float32, Float32]], x: Float32) -> Float32:
    """Slopes [M,out,in] of the mean output."""

    def mean(row: torch.Tensor) -> torch.Tensor:
        y = row.expand(len(net[0][0]), 1, -1)
        for i, (weight, bias) in enumerate(net):
            y = torch.relu(y) if i else y
            y = torch.baddbmm(torch.from_numpy(bias)[:, None], y, torch.from_numpy(weight))
        return y.mean(0)[0]

    rows = torch.from_numpy(x)
    return np.stack([torch.func.jacrev(mean)(row).numpy() for row in rows])


@pytest.mark.parametrize("members", [1, 3])
@pytest.mark.parametrize("widths", [[8], [31, 9], [16, 17, 18]])
def test_slopes_are_torchs(widths: list[int], members: int) -> None:
    net = layers(widths, members)
    x = np.random.default_rng(1).normal(size=(ROWS, INPUTS)).astype(np.float32)
    expected = by_torch(net, x)
    found = MeanSlopes(net)(x, INPUTS)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-4 * np.abs(expected).max())
    np.testing.assert_array_equal(MeanSlopes(net)(x, 4), MeanSlopes(net)(x, INPUTS)[:, :, :4])


def test_where_no_unit_is_on_nothing_moves() -> None:
    net = layers([9, 9], 2)
    net[1][1][:] = -1e6
    x = np.ones((3, INPUTS), np.float32)
    assert not MeanSlopes(net)(x, INPUTS).any()
    assert MeanSlopes(net)(x[:0], INPUTS).shape == (0, OUTPUTS, INPUTS)
