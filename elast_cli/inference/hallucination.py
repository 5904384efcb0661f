"""HTM's networks as functions on arrays: what is seen, generated images, scores, actions.

An image is known by two embeddings beside each other [2Z]: that of the score and that of the
inverse model. Both see reconstructions, whose artifacts are those of generated images.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.control.base import Task
from elast_cli.inference.frames import pooled
from elast_cli.models.cvae.images import as_bytes, unit
from elast_cli.models.cvae.net import Cvae
from elast_cli.models.htm.net import Htm
from elast_cli.seeding import generator
from elast_cli.shapes import Float32, Uint8

CHUNK = 50  # images at once


class Hallucination:
    """HTM's estimator, generator of images, scores and inverse model; rows are independent.

    It is an `Estimator` and an `Imagination`. A context is the flattened context image, or nothing.
    """

    def __init__(self, cvae: Cvae, htm: Htm) -> None:
        """Take trained networks, on one device."""
        self._cvae, self._htm = cvae, htm
        self._latent, self.action_size = cvae.config.latent_size, htm.action_size
        self._device = htm.score.bilinear.device

    def begin(self, task: Task) -> tuple[Float32, Uint8 | None]:
        """Embeddings of the goals [B,2Z]; the state is the context images, which never change."""
        return self._seen(task.goal, task.context), task.context

    def update(
        self, state: Uint8 | None, frames: Uint8, last_action: Float32 | None
    ) -> tuple[Float32, Uint8 | None]:
        """Embeddings f32 [B,2Z] of the last frames, whatever was done before.

        Args:
            state: context images u8 [B,64,64,3], or None where there are none.
            frames: stacks u8 [B,F,64,64,3].
            last_action: f32 [B,A]; not used.
        """
        return self._seen(frames, state), state

    def contexts(self, images: Uint8 | None, rows: int) -> Float32:
        """Pooled context images of B = `rows` episodes in [0, 1], flattened: [B,C]."""
        if not self._cvae.has_context:
            return np.zeros((rows, 0), np.float32)
        if images is None:
            raise ValueError("the environment shows no context images")
        found: Float32 = self._images(images).flatten(1).cpu().numpy()
        return found

    @torch.inference_mode()
    def nodes(self, context: Float32, seed: int, count: int) -> Float32:
        """Embeddings f32 [N,2Z] of generated images.

        Args:
            context: the pooled context image f32 [C].
            seed: of their latents.
            count: how many, N.
        """
        shown = self._context(context)
        found = [
            self._embedded(images, shown.expand(len(images), -1, -1, -1))
            for images in self._generated(shown, seed, count).split(CHUNK)
        ]
        return np.concatenate(found)

    @torch.inference_mode()
    def pictures(self, context: Float32, seed: int, count: int) -> Uint8:
        """The images that `nodes` embeds, u8 [N,S,S,3].

        Arguments as in `Hallucination.nodes`.
        """
        return as_bytes(self._generated(self._context(context), seed, count))

    @torch.inference_mode()
    def scores(self, z: Float32, z_next: Float32) -> Float32:
        """s(o, o') [M,N] of all pairs of embeddings [M,2Z] and [N,2Z]."""
        ends = (torch.from_numpy(x[:, : self._latent]).to(self._device) for x in (z, z_next))
        found: Float32 = self._htm.score(*ends).cpu().numpy()
        return found

    @torch.inference_mode()
    def act(self, z: Float32, z_next: Float32, context: Float32) -> Float32:
        """The inverse model's actions f32 [B,A].

        Args:
            z: embeddings of the images before, f32 [B,2Z].
            z_next: of those after, f32 [B,2Z].
            context: f32 [B,C]; not used, since embeddings know it.
        """
        ends = (torch.from_numpy(x[:, self._latent :]).to(self._device) for x in (z, z_next))
        rows = zip(*(end.split(1) for end in ends), strict=True)
        found: Float32 = torch.cat([self._htm.inverse(*row) for row in rows]).cpu().numpy()
        return found

    @torch.inference_mode()
    def _seen(self, frames: Uint8, context: Uint8 | None) -> Float32:
        """Embeddings [B,2Z] of reconstructed frames, one row after the other."""
        images = self._images(np.ascontiguousarray(frames[:, -1]))
        shown = images[:, :0]
        if self._cvae.has_context and context is not None:
            shown = self._images(context)
        rows = zip(images.split(1), shown.split(1), strict=True)
        return np.concatenate([self._embedded(self._cvae.reconstructed(*r), r[1]) for r in rows])

    def _images(self, pixels: Uint8) -> Tensor:
        """Frames u8 [B,64,64,3] as the networks take them: [B,3,S,S] in [0, 1]."""
        return unit(torch.from_numpy(pooled(pixels, self._cvae.pool)).to(self._device))

    def _context(self, context: Float32) -> Tensor:
        """A context [C] as an image [1,0 or 3,S,S]."""
        side = self._cvae.side
        return torch.from_numpy(context.reshape(1, -1, side, side)).to(self._device)

    def _generated(self, shown: Tensor, seed: int, count: int) -> Tensor:
        """Images [N,3,S,S] in the context of one context image [1,0 or 3,S,S]."""
        noise = generator("plan", seed).standard_normal((count, self._latent), np.float32)
        prior = self._cvae.prior_of(shown)
        z = prior.at(torch.from_numpy(noise).to(self._device))
        return torch.cat([self._cvae.images(part) for part in z.split(CHUNK)])

    def _embedded(self, images: Tensor, shown: Tensor) -> Float32:
        """Both embeddings [M,2Z] of images and their context images."""
        encoders = self._htm.score.encoder, self._htm.inverse.encoder
        both = torch.cat([encoder(images, shown) for encoder in encoders], dim=1)
        found: Float32 = both.cpu().numpy()
        return found
