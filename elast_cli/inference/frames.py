"""The encoder as a function from frames to latents."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from elast_cli.control.base import Task
from elast_cli.inference.dense import DenseNetwork
from elast_cli.models.encoder.config import EncoderConfig
from elast_cli.models.tensors import Array, Arrays, under
from elast_cli.shapes import Float32, Uint8

if TYPE_CHECKING:
    from torch import nn


class FrameEncoder:
    """φ on stacked frames, row by row independent. Only one that convolves needs torch."""

    def __init__(self, config: EncoderConfig, arrays: Arrays, device: str = "cpu") -> None:
        """Take φ's configuration and its tensors.

        Args:
            config: of the encoder.
            arrays: its tensors by name: `net.…`, `mean`, `scale`, and `colours` if it whitens.
            device: where to compute, in torch's terms.
        """
        self.config, self.device = config, device
        self.arrays = arrays
        net = under(arrays, "net")
        convolves = config.architecture == "conv"
        self._dense = None if convolves else DenseNetwork.of(net, device)
        self._conv = _conv_stack(config, net, device) if convolves else None

    def begin(self, task: Task) -> tuple[Float32, Uint8 | None]:
        """Latents of the goals [B,Z]; the state is the context images, which never change."""
        return self(task.goal, task.context), task.context

    def update(
        self, state: Uint8 | None, frames: Uint8, last_action: Float32 | None
    ) -> tuple[Float32, Uint8 | None]:
        """Latents [B,Z] of frames [B,F,64,64,3], whatever was done before.

        Arguments as in `Estimator.update`; the state is context images u8 [B,64,64,3], or
        None.
        """
        return self(frames, state), state

    def __call__(self, frames: Uint8, context: Uint8 | None) -> Float32:
        """[B,F,64,64,3] and context images [B,64,64,3], where there are any -> [B,Z]."""
        seen = frames[:, -self.config.frames :]
        x = self._normalized(pooled_stacks(seen, context, self.config.pool))
        if self._dense is not None:
            found: Float32 = self._dense(x.reshape(len(x), -1))[0]
            return found
        return self._convolved(x)

    def _normalized(self, features: Array) -> Float32:
        """`PooledImages.normalized`: float32 [B,F,3,S,S] of float16 features, to the bit."""
        mean: Float32 = self.arrays["mean"]
        scale: Float32 = self.arrays["scale"]
        x: Float32 = (features.astype(np.float32) - mean) / scale
        if not self.config.whiten:
            return x
        pixels = np.moveaxis(x, 2, -1)  # [B,F,S,S,3]
        mixed = pixels.reshape(-1, 3) @ self.arrays["colours"].T
        return np.ascontiguousarray(np.moveaxis(mixed.reshape(pixels.shape), -1, 2))

    def _convolved(self, x: Float32) -> Float32:
        """Latents [B,Z] of normalised images [B,F,3,S,S], one row after the other."""
        import torch

        assert self._conv is not None
        with torch.inference_mode():
            rows = torch.from_numpy(x).to(self.device).flatten(1, 2).split(1)
            found: Float32 = torch.cat([self._conv(row) for row in rows]).cpu().numpy()
        return found


def pooled_stacks(frames: Uint8, context: Uint8 | None, pool: int) -> Array:
    """Frames [B,F,64,64,3] less context images [B,64,64,3], if any: float16 [B,F,3,S,S].

    Args:
        frames: u8 [B,F,64,64,3].
        context: u8 [B,64,64,3], or None.
        pool: side of the squares of pixels that are averaged; S = 64 / pool.

    Returns:
        float16 in [0, 255], less the context image if there is one.
    """
    features = pooled(frames.reshape(-1, *frames.shape[2:]), pool)
    features = features.reshape(*frames.shape[:2], *features.shape[1:])
    return features if context is None else features - pooled(context, pool)[:, None]


def pooled(frames: Uint8, pool: int) -> Array:
    """`PooledImages.preprocess`: frames u8 [N,64,64,3] averaged to float16 [N,3,S,S], to the bit.

    All sums are whole numbers, and so the same in any order.
    """
    count, side = len(frames), frames.shape[1] // pool
    rows = frames.reshape(count, side, pool, -1).sum(2, dtype=np.uint16)
    columns = rows.reshape(count, side, side, pool, -1)
    total = columns[:, :, :, 0].copy()
    for i in range(1, pool):
        total += columns[:, :, :, i]
    half = (total.astype(np.float32) / np.float32(pool * pool)).astype(np.float16)
    return np.ascontiguousarray(half.transpose(0, 3, 1, 2))


def _conv_stack(config: EncoderConfig, arrays: Arrays, device: str) -> nn.Module:
    """φ's convolutions with these tensors."""
    import torch

    from elast_cli.models.encoder.net import ConvStack

    net = ConvStack(config)
    net.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
    return net.requires_grad_(False).eval().to(device)
