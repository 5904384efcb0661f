"""Networks of linear layers on arrays: a row's result does not depend on the rows beside it.

Library products choose their algorithm by the batch's size, so that a row's last bit changes with
its neighbours; they also cost more to call than small batches cost to compute. These kernels add
up each output in one fixed order, whatever the batch. On other devices than the CPU torch runs the
same layers, without that promise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numba import njit
from torch import Tensor, nn

from elast_cli.models.nets import EnsembleLinear
from elast_cli.shapes import Float32

NARROW = 32  # outputs below which a layer is computed as dot products
BLOCK = 64  # rows whose hidden values stay in the first cache


class DenseNetwork:
    """E networks of the same shape with ReLU between their layers, on the same inputs."""

    def __init__(self, layers: Sequence[tuple[Tensor, Tensor]]) -> None:
        """Take the layers as weights [E,in,out] and biases [E,out]."""
        self.device = layers[0][0].device
        self.layers = [(w.detach(), b.detach()) for w, b in layers]
        self.inputs = layers[0][0].shape[1]
        packed = [_pack(w, b, last=i + 1 == len(layers)) for i, (w, b) in enumerate(self.layers)]
        self._weights = tuple(weight for weight, _ in packed)
        self._biases = tuple(bias for _, bias in packed)

    @classmethod
    def of(cls, net: nn.Module) -> DenseNetwork:
        """One network, or the ensemble, that a module's linear layers make up."""
        layers: list[tuple[Tensor, Tensor]] = []
        for layer in net.modules():
            if isinstance(layer, nn.Linear):
                layers.append((layer.weight.T[None], layer.bias[None]))
            elif isinstance(layer, EnsembleLinear):
                layers.append((layer.weight, layer.bias[:, 0]))
        return cls(layers)

    def __call__(self, x: Float32) -> Float32:
        """[M,in] -> [E,M,out]."""
        if self.device.type != "cpu":
            return self._on_device(x)
        members, outputs = self._biases[-1].shape
        out = np.empty((members, len(x), outputs), np.float32)
        _forward(x, self._weights, self._biases, out)
        return out

    @torch.inference_mode()
    def _on_device(self, x: Float32) -> Float32:
        y = torch.from_numpy(x).to(self.device).expand(len(self.layers[0][0]), -1, -1)
        for i, (weight, bias) in enumerate(self.layers):
            y = torch.baddbmm(bias[:, None], torch.relu(y) if i else y, weight)
        return y.cpu().numpy()


def _pack(weight: Tensor, bias: Tensor, *, last: bool) -> tuple[Float32, Float32]:
    """Weights for the kernels: inputs and hidden outputs in fours, narrow layers transposed."""
    members, n_in, n_out = weight.shape
    more_in, more_out = -n_in % 4, 0 if last else -n_out % 4
    w = np.zeros((members, n_in + more_in, n_out + more_out), np.float32)
    b = np.zeros((members, n_out + more_out), np.float32)
    w[:, :n_in, :n_out] = weight.cpu().numpy()
    b[:, :n_out] = bias.cpu().numpy()
    return (np.ascontiguousarray(w.transpose(0, 2, 1)) if b.shape[1] < NARROW else w), b


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"})
def _narrow(x: Float32, weight: Float32, bias: Float32, out: Float32) -> None:
    """Out [M,out] as dot products of x [M,in] and weight [out,in]."""
    for i in range(x.shape[0]):
        for j in range(weight.shape[0]):
            total = np.float32(0)
            for k in range(x.shape[1]):
                total += x[i, k] * weight[j, k]
            out[i, j] = total + bias[j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _wide(x: Float32, weight: Float32, bias: Float32, out: Float32) -> None:
    """Out [M,out] from x [M,in] and weight [in,out]; M and in are multiples of four.

    Four rows by four inputs at a time: each weight and each partial sum is loaded once for four
    products, which keeps the vector units busy.
    """
    for i in range(0, x.shape[0], 4):
        x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
        y0, y1, y2, y3 = out[i], out[i + 1], out[i + 2], out[i + 3]
        for j in range(out.shape[1]):
            y0[j] = y1[j] = y2[j] = y3[j] = bias[j]
        for k in range(0, x.shape[1], 4):
            w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
            a0, a1, a2, a3 = x0[k], x0[k + 1], x0[k + 2], x0[k + 3]
            b0, b1, b2, b3 = x1[k], x1[k + 1], x1[k + 2], x1[k + 3]
            c0, c1, c2, c3 = x2[k], x2[k + 1], x2[k + 2], x2[k + 3]
            d0, d1, d2, d3 = x3[k], x3[k + 1], x3[k + 2], x3[k + 3]
            for j in range(out.shape[1]):
                v0, v1, v2, v3 = w0[j], w1[j], w2[j], w3[j]
                y0[j] = y0[j] + a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
                y1[j] = y1[j] + b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
                y2[j] = y2[j] + c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3
                y3[j] = y3[j] + d0 * v0 + d1 * v1 + d2 * v2 + d3 * v3


@njit(cache=True, nogil=True, error_model="numpy")
def _layer(x: Float32, weight: Float32, bias: Float32) -> Float32:
    out = np.empty((x.shape[0], bias.shape[0]), np.float32)
    if bias.shape[0] < NARROW:
        _narrow(x, weight, bias, out)
    else:
        _wide(x, weight, bias, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _forward(
    x: Float32, weights: tuple[Float32, ...], biases: tuple[Float32, ...], out: Float32
) -> None:
    """Fill out [E,M,out] block by block; weights [E,in,out] or, if narrow, [E,out,in]."""
    inputs = weights[0].shape[2] if biases[0].shape[1] < NARROW else weights[0].shape[1]
    for start in range(0, x.shape[0], BLOCK):
        rows = min(BLOCK, x.shape[0] - start)
        padded = np.zeros((rows + -rows % 4, inputs), np.float32)
        padded[:rows, : x.shape[1]] = x[start : start + rows]
        for e in range(out.shape[0]):
            y = _layer(padded, weights[0][e], biases[0][e])
            for layer in range(1, len(weights)):
                hidden = y.reshape(-1)
                for i in range(len(hidden)):
                    hidden[i] = max(hidden[i], np.float32(0))
                y = _layer(y, weights[layer][e], biases[layer][e])
            out[e, start : start + rows] = y[:rows]
