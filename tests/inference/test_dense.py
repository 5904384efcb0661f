from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from elast_cli.inference.dense import DenseNetwork
from elast_cli.models.files import arrays_of
from elast_cli.models.nets import EnsembleLinear, mlp
from elast_cli.shapes import Float32


def array(*shape: int) -> Float32:
    return np.random.default_rng(0).standard_normal(shape, dtype=np.float32)


@pytest.mark.parametrize(
    "sizes", [(10, 128, 128, 8), (3, 7, 33, 1), (40, 50), (5, 31, 2), (4, 260)]
)
@pytest.mark.parametrize("rows", [0, 1, 3, 64, 131])
def test_a_network_is_that_of_torch(sizes: tuple[int, ...], rows: int) -> None:
    net, x = mlp(sizes), array(rows, sizes[0])
    found = DenseNetwork.of(arrays_of(net))(x)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, net(torch.from_numpy(x))[None].detach(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("width", [*range(27, 34), 127, 128, 129])
@pytest.mark.parametrize("depth", [1, 2])
def test_layers_of_every_width_are_those_of_torch(width: int, depth: int) -> None:
    for sizes in ([5] + [width] * depth + [3], [width] * (depth + 1), [width, 9]):
        net, x = mlp(sizes), array(7, sizes[0])
        expected = net(torch.from_numpy(x))[None].detach()
        np.testing.assert_allclose(
            DenseNetwork.of(arrays_of(net))(x), expected, rtol=1e-4, atol=1e-5
        )


@pytest.mark.parametrize("shape", [(3, 4), (3, 6), (3, 0), (5,), (2, 3, 5)])
def test_rows_of_another_width_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="5 inputs"):
        DenseNetwork.of(arrays_of(mlp([5, 33, 2])))(array(*shape))


def test_every_member_of_an_ensemble_sees_the_same_rows() -> None:
    layers = nn.ModuleList([EnsembleLinear(3, 6, 40), EnsembleLinear(3, 40, 4)])
    x = array(9, 6)
    hidden = torch.relu(layers[0](torch.from_numpy(x).expand(3, -1, -1)))
    np.testing.assert_allclose(
        DenseNetwork.of(arrays_of(layers))(x), layers[1](hidden).detach(), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("sizes", [(10, 128, 128, 8), (6, 37, 40)])
def test_a_row_does_not_depend_on_its_neighbors_to_the_bit(sizes: tuple[int, ...]) -> None:
    net, x = DenseNetwork.of(arrays_of(mlp(sizes))), array(150, sizes[0])
    whole = net(x)[0]
    shuffled = np.random.default_rng(1).permutation(len(x))
    np.testing.assert_array_equal(net(x[shuffled])[0], whole[shuffled])
    for size in (1, 2, 3, 4, 5, 7, 32, 65):
        np.testing.assert_array_equal(net(x[:size])[0], whole[:size])
