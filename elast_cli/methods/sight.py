"""What a method sees: latents of frames, and the vectors of context images."""

from __future__ import annotations

import numpy as np

from elast_cli.control.base import ContextReader
from elast_cli.inference.frames import FrameEncoder
from elast_cli.methods.loading import Models
from elast_cli.models.parts import CONTEXT
from elast_cli.models.tensors import under
from elast_cli.shapes import Float32, Uint8


def frame_encoder(models: Models) -> FrameEncoder:
    """φ on frames."""
    encoder = models.stored("encoder")
    return FrameEncoder(encoder.spec.net, under(encoder.arrays, "encoder"), models.device)


def contexts(models: Models) -> ContextReader:
    """The context autoencoder on context images; C = 0 where the method has none."""
    if CONTEXT not in models.folders:
        return no_contexts
    from elast_cli.inference.contexts import ContextVectors
    from elast_cli.models.context.net import ContextAutoencoder

    return ContextVectors(models.part(CONTEXT, ContextAutoencoder))


def no_contexts(images: Uint8 | None, rows: int) -> Float32:
    """The vectors [B,0] of B = `rows` episodes whose contexts the method does not see."""
    return np.zeros((rows, 0), np.float32)
