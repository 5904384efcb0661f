"""The tensors of trained parts, without torch: which there are, reading them, quantiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

from numpy.typing import NDArray

from elast_cli.shapes import Float64

QUANTILE_GRID = 1001

Array = NDArray[Any]
Arrays = Mapping[str, Array]  # tensors by name


class Want(NamedTuple):
    """What a tensor is expected to be."""

    dtype: str
    shape: tuple[int, ...]


Wanted = dict[str, Want]  # by name, layers from the first to the last


def floats(*shape: int) -> Want:
    """A float32 tensor of that shape."""
    return Want("float32", shape)


def network(at: str, sizes: Sequence[int], members: int | None = None) -> Wanted:
    """Those of `nets.mlp` of these sizes, or of as many `EnsembleLinear` layers.

    Args:
        at: name of the network.
        sizes: of all layers, from inputs to outputs.
        members: number of networks; None: a single one, without that axis.
    """
    found: Wanted = {}
    for i, (inner, outer) in enumerate(pairwise(sizes)):
        if members is None:
            found[f"{at}.{2 * i}.weight"] = floats(outer, inner)
            found[f"{at}.{2 * i}.bias"] = floats(outer)
        else:
            found[f"{at}.{i}.weight"] = floats(members, inner, outer)
            found[f"{at}.{i}.bias"] = floats(members, 1, outer)
    return found


def scale(at: str, latent_size: int) -> Wanted:
    """Those of a `nets.LatentScale`."""
    return {f"{at}.{name}": floats(latent_size) for name in ("mean", "std", "step")}


def quantiles(at: str) -> Wanted:
    """That of a `nets.QuantileTable`."""
    return {f"{at}.values": Want("float64", (QUANTILE_GRID,))}


def under(arrays: Arrays, prefix: str) -> dict[str, Array]:
    """The tensors whose names begin with `prefix` and a dot, by the rest of their names."""
    start = f"{prefix}."
    return {name[len(start) :]: x for name, x in arrays.items() if name.startswith(start)}


def quantile(values: Float64, probability: float) -> float:
    """Value of a table [QUANTILE_GRID] below which a share `probability` of the samples lies."""
    position = probability * (QUANTILE_GRID - 1)
    low = int(position)
    weight = position - low
    below, above = float(values[low]), float(values[min(low + 1, QUANTILE_GRID - 1)])
    gap = Fraction(above - below)  # exact from here on: rounded once, as by a fused multiply-add
    if weight < 0.5:
        return float(Fraction(below) + Fraction(weight) * gap)
    return float(Fraction(above) - Fraction(1 - weight) * gap)
