"""Networks of linear layers on arrays: a row's result does not depend on the rows beside it.

Library products choose their algorithm by the batch's size, so that a row's last bit changes with
its neighbours; they also cost more to call than small batches cost to compute. These kernels add
up each output in one fixed order, whatever the batch. On other devices than the CPU torch runs the
same layers, without that promise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from elast_cli.compiled import njit
from elast_cli.models.tensors import Arrays
from elast_cli.shapes import Float32

if TYPE_CHECKING:
    from torch import Tensor

NARROW = 32  # outputs below which a layer is computed as dot products
PANEL = 128  # outputs of a wide layer computed together; a constant, so that loops are unrolled
ROWS = 6  # computed together: with PANEL and four inputs as many sums as there are registers
BLOCK = 10 * ROWS  # rows whose hidden values stay in the first cache


class DenseNetwork:
    """E networks of the same shape with ReLU between their layers, on the same inputs."""

    def __init__(self, layers: Sequence[tuple[Float32, Float32]], device: str = "cpu") -> None:
        """Take the layers as weights [E,in,out] and biases [E,out]."""
        self.device = device
        self.layers = list(layers)
        self.inputs = layers[0][0].shape[1]
        self.outputs = layers[-1][1].shape[1]
        packed = [_pack(w, b) for w, b in self.layers]
        self._weights = tuple(weight for weight, _ in packed)
        self._biases = tuple(bias for _, bias in packed)
        self._there: list[tuple[Tensor, Tensor]] = []  # the layers on another device

    @classmethod
    def of(cls, arrays: Arrays, device: str = "cpu") -> DenseNetwork:
        """The tensors of one network, `nets.mlp`, or of an ensemble, layers in their order."""
        layers: list[tuple[Float32, Float32]] = []
        for name, weight in arrays.items():
            if name.endswith("weight"):
                bias = arrays[name.removesuffix("weight") + "bias"]
                single = weight.ndim == 2
                layers.append((weight.T[None], bias[None]) if single else (weight, bias[:, 0]))
        return cls(layers, device)

    def __call__(self, x: Float32) -> Float32:
        """[M,in] -> [E,M,out].

        Raises:
            ValueError: rows are not as wide as the network's inputs.
        """
        if x.ndim != 2 or x.shape[1] != self.inputs:
            raise ValueError(f"a network of {self.inputs} inputs was given an array {x.shape}")
        if self.device != "cpu":
            return self._on_device(x)
        out = np.empty((len(self._biases[-1]), len(x), self.outputs), np.float32)
        _forward(x, self._weights, self._biases, out)
        return out

    def _on_device(self, x: Float32) -> Float32:
        import torch

        def there(array: Float32) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

        if not self._there:
            self._there = [(there(weight), there(bias)) for weight, bias in self.layers]
        with torch.inference_mode():
            y = there(x).expand(len(self.layers[0][0]), -1, -1)
            for i, (weight, bias) in enumerate(self._there):
                y = torch.baddbmm(bias[:, None], torch.relu(y) if i else y, weight)
            return y.cpu().numpy()


def _padded(size: int) -> int:
    """Values of a layer in memory: in fours, or in whole panels."""
    fours = size + -size % 4
    return fours if fours < NARROW else size + -size % PANEL


def _pack(weight: Float32, bias: Float32) -> tuple[Float32, Float32]:
    """Weights [E,P,in,PANEL], or [E,1,out,in] for narrow layers, and biases [E,out]; padded."""
    members, n_in, n_out = weight.shape
    w = np.zeros((members, _padded(n_in), _padded(n_out)), np.float32)
    b = np.zeros((members, w.shape[2]), np.float32)
    w[:, :n_in, :n_out] = weight
    b[:, :n_out] = bias
    if w.shape[2] < NARROW:
        panels = w.transpose(0, 2, 1)[:, None]
    else:
        panels = w.reshape(members, w.shape[1], -1, PANEL).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(panels), b


@njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"})
def _narrow(x: Float32, weight: Float32, bias: Float32, out: Float32) -> None:
    """Out [M,out] as dot products of x [M,in] and weight [out,in]."""
    for i in range(x.shape[0]):
        for j in range(weight.shape[0]):
            total = np.float32(0)
            for k in range(x.shape[1]):
                total += x[i, k] * weight[j, k]
            out[i, j] = total + bias[j]


@njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _wide(x: Float32, weight: Float32, bias: Float32, out: Float32) -> None:
    """Out [M,P·PANEL] from x [M,in] and weight [P,in,PANEL]; M is a multiple of ROWS, in of four.

    Six rows by four inputs at a time: each weight and each partial sum is loaded once for many
    products. A panel's sums lie in an array of their own, which nothing else can overlap.
    """
    sums = np.empty((ROWS, PANEL), np.float32)
    y0, y1, y2, y3, y4, y5 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    for panel in range(weight.shape[0]):
        first = panel * PANEL
        for i in range(0, x.shape[0], ROWS):
            x0, x1, x2, x3, x4, x5 = x[i], x[i + 1], x[i + 2], x[i + 3], x[i + 4], x[i + 5]
            for j in range(PANEL):
                y0[j] = y1[j] = y2[j] = y3[j] = y4[j] = y5[j] = bias[first + j]
            for k in range(0, x.shape[1], 4):
                w0, w1 = weight[panel, k], weight[panel, k + 1]
                w2, w3 = weight[panel, k + 2], weight[panel, k + 3]
                a0, a1, a2, a3 = x0[k], x0[k + 1], x0[k + 2], x0[k + 3]
                b0, b1, b2, b3 = x1[k], x1[k + 1], x1[k + 2], x1[k + 3]
                c0, c1, c2, c3 = x2[k], x2[k + 1], x2[k + 2], x2[k + 3]
                d0, d1, d2, d3 = x3[k], x3[k + 1], x3[k + 2], x3[k + 3]
                e0, e1, e2, e3 = x4[k], x4[k + 1], x4[k + 2], x4[k + 3]
                f0, f1, f2, f3 = x5[k], x5[k + 1], x5[k + 2], x5[k + 3]
                for j in range(PANEL):
                    v0, v1, v2, v3 = w0[j], w1[j], w2[j], w3[j]
                    y0[j] = y0[j] + a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
                    y1[j] = y1[j] + b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
                    y2[j] = y2[j] + c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3
                    y3[j] = y3[j] + d0 * v0 + d1 * v1 + d2 * v2 + d3 * v3
                    y4[j] = y4[j] + e0 * v0 + e1 * v1 + e2 * v2 + e3 * v3
                    y5[j] = y5[j] + f0 * v0 + f1 * v1 + f2 * v2 + f3 * v3
            for row in range(ROWS):
                for j in range(PANEL):
                    out[i + row, first + j] = sums[row, j]


@njit(nogil=True, error_model="numpy")
def _layer(x: Float32, weight: Float32, bias: Float32) -> Float32:
    out = np.empty((x.shape[0], bias.shape[0]), np.float32)
    if bias.shape[0] < NARROW:
        _narrow(x, weight[0], bias, out)
    else:
        _wide(x, weight, bias, out)
    return out


@njit(nogil=True, error_model="numpy")
def _forward(
    x: Float32, weights: tuple[Float32, ...], biases: tuple[Float32, ...], out: Float32
) -> None:
    """Fill out [E,M,out] block by block, with packed weights and biases."""
    inputs = weights[0].shape[3] if biases[0].shape[1] < NARROW else weights[0].shape[2]
    for start in range(0, x.shape[0], BLOCK):
        rows = min(BLOCK, x.shape[0] - start)
        padded = np.zeros((rows + -rows % ROWS, inputs), np.float32)
        padded[:rows, : x.shape[1]] = x[start : start + rows]
        for e in range(out.shape[0]):
            y = _layer(padded, weights[0][e], biases[0][e])
            for layer in range(1, len(weights)):
                hidden = y.reshape(-1)
                for i in range(len(hidden)):
                    hidden[i] = max(hidden[i], np.float32(0))
                y = _layer(y, weights[layer][e], biases[layer][e])
            out[e, start : start + rows] = y[:rows, : out.shape[2]]


@njit(nogil=True)
def tanh(x: Float32) -> Float32:
    """Element by element: numpy's vectors and their ends need not agree in the last bit."""
    out = np.empty_like(x)
    for m in range(x.shape[0]):
        for d in range(x.shape[1]):
            out[m, d] = np.tanh(x[m, d])
    return out
