"""Context images as the vectors that dynamics, density and policy are given."""

from __future__ import annotations

from elast_cli.models.context.net import ContextAutoencoder, context_vectors
from elast_cli.shapes import Float32, Uint8


class ContextVectors:
    """The context autoencoder's codes, row by row independent."""

    def __init__(self, model: ContextAutoencoder) -> None:
        self.model = model

    def __call__(self, images: Uint8 | None, rows: int) -> Float32:
        """Context images u8 [B,64,64,3] of B = `rows` episodes -> [B,C]."""
        if images is None:
            raise ValueError("the environment shows no context images")
        return context_vectors(self.model, images)
