from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from elast_cli.models.nets import EnsembleLinear, QuantileTable, mlp


def test_an_ensemble_layer_equals_separate_layers() -> None:
    torch.manual_seed(0)
    layer = EnsembleLinear(3, 5, 2)
    x = torch.randn(3, 7, 5)
    for e in range(3):
        single = nn.Linear(5, 2)
        single.load_state_dict({"weight": layer.weight[e].T, "bias": layer.bias[e, 0]})
        torch.testing.assert_close(layer(x)[e], single(x[e]))


def test_an_ensembles_members_begin_apart() -> None:
    layer = EnsembleLinear(2, 5, 2)
    assert not torch.equal(layer.weight[0], layer.weight[1])


def test_a_network_is_linear_after_its_last_layer() -> None:
    net = mlp([3, 8, 4, 2])
    assert [type(layer) for layer in net] == [nn.Linear, nn.ReLU, nn.Linear, nn.ReLU, nn.Linear]


def test_quantiles_of_a_known_sample() -> None:
    table = QuantileTable()
    table.fit(torch.arange(11.0).flip(0))
    assert [table.at(p) for p in (0, 0.25, 0.5, 0.99, 1)] == pytest.approx([0, 2.5, 5, 9.9, 10])


@given(
    st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=50),
    st.integers(0, 1000),
)
def test_quantiles_are_those_of_numpy(samples: list[float], thousandths: int) -> None:
    table = QuantileTable()
    table.fit(torch.tensor(samples))
    expected = np.quantile(np.array(samples), thousandths / 1000)
    assert table.at(thousandths / 1000) == pytest.approx(expected, abs=0.1)


def test_quantiles_between_the_stored_ones_are_interpolated() -> None:
    table = QuantileTable()
    table.fit(torch.linspace(0, 1, 1001, dtype=torch.float64))
    assert table.at(0.1234) == pytest.approx(0.1234, abs=1e-6)
