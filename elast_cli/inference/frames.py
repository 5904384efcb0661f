"""The encoder as a function from frames to latents."""

from __future__ import annotations

import torch

from elast_cli.control.base import Task
from elast_cli.inference.dense import DenseNetwork
from elast_cli.models.encoder.net import Encoder
from elast_cli.shapes import Float32, Uint8


class FrameEncoder:
    """φ on stacked frames, row by row independent."""

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        pooled = encoder.config.architecture == "pooled-mlp"
        self._net = DenseNetwork.of(encoder.net) if pooled else None

    def begin(self, task: Task) -> tuple[Float32, Uint8 | None]:
        """Latents of the goals [B,Z]; the state is the context images, which never change."""
        return self(task.goal, task.context), task.context

    def update(
        self, state: Uint8 | None, frames: Uint8, last_action: Float32 | None
    ) -> tuple[Float32, Uint8 | None]:
        """Latents [B,Z] of frames [B,F,64,64,3], whatever was done before."""
        return self(frames, state), state

    @torch.inference_mode()
    def __call__(self, frames: Uint8, context: Uint8 | None) -> Float32:
        """[B,F,64,64,3] and context images [B,64,64,3], where there are any -> [B,Z]."""
        rows = len(frames)
        device = self.encoder.mean.device
        flat = torch.from_numpy(frames.reshape(-1, *frames.shape[2:])).to(device)
        features = self.encoder.preprocess(flat).unflatten(0, (rows, -1))
        features = features[:, -self.encoder.config.frames :]
        if context is not None:
            images = self.encoder.preprocess(torch.from_numpy(context).to(device))
            features = features - images[:, None]
        if self._net is not None:
            x = self.encoder.normalized(features)
            latent: Float32 = self._net(x.flatten(1).cpu().numpy())[0]
            return latent
        parts = [self.encoder(features[b : b + 1]) for b in range(rows)]
        return torch.cat(parts).cpu().numpy()
