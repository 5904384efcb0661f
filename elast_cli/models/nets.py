"""Network parts that more than one model uses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

QUANTILE_GRID = 1001
MAX_WIDTH = 1 << 16  # sizes are bounded: they come from files


def mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Fully connected ReLU network through `sizes`; the last layer is linear."""
    layers: list[nn.Module] = []
    for n_in, n_out in pairwise(sizes[:-1]):
        layers += [nn.Linear(n_in, n_out), nn.ReLU()]
    layers.append(nn.Linear(sizes[-2], sizes[-1]))
    return nn.Sequential(*layers)


class EnsembleLinear(nn.Module):
    """`members` independent linear layers applied in one batched product: [E,M,in] -> [E,M,out]."""

    def __init__(self, members: int, n_in: int, n_out: int) -> None:
        super().__init__()
        single = [nn.Linear(n_in, n_out) for _ in range(members)]
        self.weight = nn.Parameter(torch.stack([layer.weight.detach().T for layer in single]))
        self.bias = nn.Parameter(torch.stack([layer.bias.detach() for layer in single])[:, None])

    def forward(self, x: Tensor) -> Tensor:
        """Apply member e to x[e]."""
        return torch.baddbmm(self.bias, x, self.weight)


class QuantileTable(nn.Module):
    """Quantiles of one scalar on observed transitions; thresholds come from them."""

    values: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("values", torch.zeros(QUANTILE_GRID, dtype=torch.float64))

    def fit(self, samples: Tensor) -> None:
        """Store the quantiles of `samples` [M] at 0, 0.001, ..., 1."""
        ordered, _ = torch.sort(samples.detach().to(self.values).flatten())
        position = torch.linspace(0, len(ordered) - 1, QUANTILE_GRID).to(ordered)
        low = position.floor().long()
        high = position.ceil().long()
        self.values.copy_(torch.lerp(ordered[low], ordered[high], position - low))

    def at(self, probability: float) -> float:
        """Value below which a share `probability` of the observed samples lies."""
        position = probability * (QUANTILE_GRID - 1)
        low = int(position)
        high = min(low + 1, QUANTILE_GRID - 1)
        return float(torch.lerp(self.values[low], self.values[high], position - low))
