"""What ψ's transitions are contrasted with (Sec. 3: its support must contain the data's)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from elast_cli.shapes import Int64

POOL = 6000  # latents among which each one's neighbours are looked for
KEPT = 64  # neighbours of each
FEWEST = 8  # that a neighbourhood holds, however far away they are
FINEST = 0.05  # of the Gaussian's deviation, in what is added to neighbours
PART = 512


class Noise:
    """Draws ν false successors of a latent: Gaussian ones about it, and latents from near by.

    Encoded data fill no more than a thin sheet of the latent space, which Gaussian noise leaves at
    once: telling the two apart teaches ψ the sheet and hardly anything about who can be reached on
    it. Latents of other times that lie near by are on the sheet, where a tree asks for edges. Half
    of them are moved off it, by a little or by up to a step, as errors of H_f do.
    """

    def __init__(
        self,
        z: Tensor,
        train: Tensor,
        *,
        std: Tensor,
        ratio: int,
        near: int,
        radius: float,
        rng: np.random.Generator,
    ) -> None:
        """Look up everybody's neighbours.

        Args:
            z: all latents [N,Z].
            train: rows [M] that may serve as noise.
            std: deviation of the Gaussian [Z].
            ratio: successors to draw for each latent, ν.
            near: how many of them come from near by.
            radius: what near by means, in latent units.
            rng: of the random subset of neighbours that is kept.
        """
        self.z, self.std = z, std
        self.ratio, self.near = ratio, near
        self.neighbours = _neighbours(z, train, radius, rng) if near else None

    def draw(self, rows: Tensor, rng: np.random.Generator) -> Tensor:
        """False successors [ν,M,Z] of the latents at `rows` [M]."""
        shape = (self.ratio - self.near, len(rows), self.z.shape[1])
        normal = torch.from_numpy(rng.standard_normal(shape, dtype=np.float32)).to(self.z.device)
        gaussian = self.z[rows] + normal * self.std
        if self.neighbours is None:
            return gaussian
        which = rng.integers(self.neighbours.shape[1], size=(self.near, len(rows)))
        near = self.z[self.neighbours[rows, torch.from_numpy(which).to(rows.device)]]
        half = self.near // 2
        move = rng.standard_normal((half, *near.shape[1:]), dtype=np.float32)
        move *= np.float32(FINEST) ** rng.random((half, len(rows), 1), dtype=np.float32)
        near[:half] += torch.from_numpy(move).to(near) * self.std
        return torch.cat([near, gaussian])


def _neighbours(z: Tensor, train: Tensor, radius: float, rng: np.random.Generator) -> Tensor:
    """For each latent [N,Z] the rows [N,K] of random ones of `train` within `radius` of it."""
    found = []
    for part in z.split(PART):
        pick: Int64 = rng.choice(len(train), min(POOL, len(train)), replace=False)
        pool = train[torch.from_numpy(pick).to(train.device)]
        kept = min(KEPT, len(pool))
        gap = torch.cdist(part, z[pool])
        order = torch.from_numpy(rng.random((len(part), len(pool)), dtype=np.float32)).to(gap)
        gap = torch.where(gap <= radius, order * radius, gap)  # within it in random order
        nearest, index = gap.topk(kept, largest=False)
        inside = (nearest <= radius).sum(1, keepdim=True).clamp_min(min(FEWEST, kept))
        place = torch.arange(kept, device=z.device) % inside  # too few: the same ones again
        found.append(pool[index.gather(1, place)])
    return torch.cat(found)
