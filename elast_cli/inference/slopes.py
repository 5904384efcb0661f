"""How a network's outputs move with its inputs: exact slopes, by one pass back from the outputs.

A ReLU passes on nothing where its unit is off, and most units are: about three in five of H_f's.
So a layer's product takes a sixth of the arithmetic, at the price of picking its weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from elast_cli.compiled import njit
from elast_cli.shapes import Bool, Float32, Int64


class MeanSlopes:
    """Slopes of the mean of E networks with ReLU between their layers, on the same inputs."""

    def __init__(self, layers: Sequence[tuple[Float32, Float32]]) -> None:
        """Take the layers as weights [E,in,out] and biases [E,out]."""
        self._layers = list(layers)

    @cached_property
    def _back(self) -> list[Float32]:
        """Weights [E,out,in] of each layer; made when first asked for, since few tasks shoot."""
        return [np.ascontiguousarray(weight.transpose(0, 2, 1)) for weight, _ in self._layers]

    def __call__(self, x: Float32, inputs: int) -> Float32:
        """Slopes [M,out,inputs] at x [M,in], by the first `inputs` of the inputs.

        The last bits of an item may depend on the others in its call.
        """
        y: Float32 = x
        active: list[Bool] = []  # of each hidden layer, which units [E,M,width] are on
        for weight, bias in self._layers[:-1]:
            y = np.matmul(y, weight) + bias[:, None]
            active.append(y > 0)
            np.maximum(y, 0, out=y)
        members = len(self._back[0])
        total = np.zeros((len(x), self._back[-1].shape[1], inputs), np.float32)
        for e in range(members):
            slopes = np.repeat(self._back[-1][e][None], len(x), axis=0)
            for i in range(len(active) - 1, 0, -1):
                slopes = _pulled_back(slopes, self._back[i][e], active[i][e], active[i - 1][e])
            total += (slopes * active[0][e][:, None]) @ self._back[0][e][:, :inputs]
        return total / np.float32(members)


@njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"})
def _pulled_back(slopes: Float32, weight: Float32, above: Bool, below: Bool) -> Float32:
    """Slopes [M,Z,in] by a layer's active inputs, from those [M,Z,out] by its outputs.

    `weight` [out,in]; `above` [M,out] and `below` [M,in] say which units are on. Four outputs at a
    time: their weights are picked once for all Z.
    """
    count, size, width = slopes.shape[0], slopes.shape[1], weight.shape[1]
    out = np.zeros((count, size, width), np.float32)
    sums = np.empty((size, width), np.float32)
    picked = np.zeros((4, width), np.float32)
    w0, w1, w2, w3 = picked[0], picked[1], picked[2], picked[3]
    for m in range(count):
        on, under = np.flatnonzero(above[m]), np.flatnonzero(below[m])
        sums[:] = 0
        for k in range(0, len(on), 4):
            four = on[k : k + 4]
            _pick(weight, four, under, picked)
            j0, j1 = four[0], four[min(1, len(four) - 1)]
            j2, j3 = four[min(2, len(four) - 1)], four[-1]
            for z in range(size):
                y, a = sums[z], slopes[m, z]
                a0, a1, a2, a3 = a[j0], a[j1], a[j2], a[j3]
                for i in range(len(under)):
                    y[i] += a0 * w0[i] + a1 * w1[i] + a2 * w2[i] + a3 * w3[i]
        for z in range(size):
            for i in range(len(under)):
                out[m, z, under[i]] = sums[z, i]
    return out


@njit(nogil=True, error_model="numpy")
def _pick(weight: Float32, outputs: Int64, inputs: Int64, picked: Float32) -> None:
    """Fill `picked` [4,in] with the weights from some inputs to four outputs; zeros if fewer."""
    for k in range(4):
        row = picked[k]
        if k < len(outputs):
            source = weight[outputs[k]]
            for i in range(len(inputs)):
                row[i] = source[inputs[i]]
        else:
            row[:] = 0
