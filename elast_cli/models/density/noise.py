"""What ψ's transitions are contrasted with (Sec. 3: its support must contain the data's)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from elast_cli.shapes import Int64

Step = Callable[[Tensor, Tensor, Tensor], Tensor]  # z [M,Z], a [M,A], c [M,C] -> z' [M,Z]

POOL = 6000  # latents among which each one's neighbours are looked for
KEPT = 64  # neighbours of each
FEWEST = 8  # that a neighbourhood holds, however far away they are
FINEST = 0.05  # of the Gaussian's deviation, in what is added to neighbours
PART = 512
CROSSINGS, BEYOND = 0.4, 0.2  # shares of the noise from other contexts; the rest was seen there
TRIES = 4  # of which the one where contexts differ the most is taken


class Noise:
    """Draws ν false successors of a latent: Gaussian ones about it, and latents from near by.

    Encoded data form a thin sheet in the latent space, and Gaussian noise lies off it. Against such
    noise ψ learns the sheet, and little about which states on it are one step apart. Latents of
    other times near by lie on the sheet, as the edges of a tree do. Half of them are moved off it,
    by up to a step, because errors of H_f do the same.
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
        """Look up the neighbours of every latent.

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
        near = self.z[self.neighbours[rows, torch.from_numpy(which).to(rows.device)].long()]
        half = self.near // 2
        move = rng.standard_normal((half, *near.shape[1:]), dtype=np.float32)
        move *= np.float32(FINEST) ** rng.random((half, len(rows), 1), dtype=np.float32)
        near[:half] += torch.from_numpy(move).to(near) * self.std
        return torch.cat([near, gaussian])


@dataclass(frozen=True)
class OtherContexts:
    """Transitions of other episodes, sorted by H_f into those that fit a row's context or do not.

    Small errors of H_f lead a tree into obstacles, and it grows on from there, where there are no
    data. General noise teaches ψ little about obstacles. This noise differs from data in them
    alone. Of five transitions of a row

    - two are steps of H_f in another context that get farther than in the row's context: of a few
      tries, the one where the two differ the most. If none gets farther, as far from all
      obstacles, it is the first try, an ordinary step;
    - one is a second step in that context, from the end of such a step;
    - two are true transitions of other episodes: of a few tries, the one whose end is farthest from
      the prediction of H_f in the row's context.

    A context is seen in one short episode, and the place of that episode separates data from such
    noise as well as obstacles do. So transitions of other episodes whose ends H_f predicts in the
    row's context are relabelled: they count as data there.

    Attributes:
        z, action, context: latents [N,Z], actions [N,A] and contexts [N,C] of all rows.
        train: rows [M] at which transitions for training start.
        step: H_f, or one of its members.
        margin: how much farther, in latent units.
        alike: how near two ends count as the same, in latent units.
        count: transitions to draw for each row.
    """

    z: Tensor
    action: Tensor
    context: Tensor
    train: Tensor
    step: Step
    margin: float
    alike: float
    count: int

    @torch.no_grad()
    def relabelled(self, rows: Tensor, share: float, rng: np.random.Generator) -> Tensor:
        """Rows [M] whose transitions fit the contexts of `rows` [M].

        A `share` of them are of other episodes, or fewer: a random one that does not fit is
        replaced by the row itself, as are all others.

        Args:
            rows: i64 [M].
            share: of rows to replace, in [0, 1].
            rng: draws the rows of other episodes.

        Returns:
            i64 [M].
        """
        if not share:
            return rows
        other = self._some(rows, rng)
        asked = torch.from_numpy(rng.random(len(rows)) < share).to(rows.device)
        return torch.where(asked & (self._miss(other, rows) < self.alike), other, rows)

    @torch.no_grad()
    def draw(self, places: Tensor, rows: Tensor, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """False transitions in the contexts of `rows` [M]: sources and targets, each [count,M,Z].

        Those that leave a latent leave that of the rows `places` [M].

        Args:
            places: i64 [M], rows that give latents.
            rows: i64 [M], rows that give contexts.
            rng: draws actions, contexts and transitions.

        Returns:
            Sources and targets, f32 [count,M,Z] each.
        """
        crossings, beyond = round(CROSSINGS * self.count), round(BEYOND * self.count)
        beyond = min(beyond, crossings)
        sources: list[Tensor] = []
        targets: list[Tensor] = []
        for i in range(crossings):
            far, elsewhere = self._crossing(places, rows, rng)
            sources.append(self.z[places])
            targets.append(far)
            if i < beyond:
                sources.append(far)
                targets.append(self.step(far, self.action[self._some(rows, rng)], elsewhere))
        for _ in range(self.count - crossings - beyond):
            other = self._misfit(rows, rng)
            sources.append(self.z[other])
            targets.append(self.z[other + 1])
        return torch.stack(sources), torch.stack(targets)

    def _some(self, rows: Tensor, rng: np.random.Generator) -> Tensor:
        """As many random rows for training."""
        pick = torch.from_numpy(rng.integers(len(self.train), size=len(rows)))
        return self.train[pick.to(rows.device)]

    def _miss(self, transitions: Tensor, rows: Tensor) -> Tensor:
        """How far from where they led H_f has transitions [M] end in the contexts of rows [M]."""
        end = self.step(self.z[transitions], self.action[transitions], self.context[rows])
        miss: Tensor = (end - self.z[transitions + 1]).norm(dim=1)
        return miss

    def _misfit(self, rows: Tensor, rng: np.random.Generator) -> Tensor:
        """Of a few transitions the one that fits the contexts of `rows` [M] the least: rows [M]."""
        found = self._some(rows, rng)
        worst = self._miss(found, rows)
        for _ in range(TRIES - 1):
            other = self._some(rows, rng)
            miss = self._miss(other, rows)
            found = torch.where(miss > worst, other, found)
            worst = torch.maximum(miss, worst)
        return found

    def _crossing(
        self, places: Tensor, rows: Tensor, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Where another context than that of `rows` lets one get farther [M,Z], and it [M,C]."""
        z, own_context = self.z[places], self.context[rows]
        best = torch.full((len(rows),), -1.0, device=z.device)
        end, where = z.clone(), own_context.clone()
        for _ in range(TRIES):
            action = self.action[self._some(rows, rng)]
            context = self.context[self._some(rows, rng)]
            far, own = self.step(z, action, context), self.step(z, action, own_context)
            farther = (far - z).norm(dim=1) > (own - z).norm(dim=1) + self.margin
            gain = (far - own).norm(dim=1) * farther
            better = gain > best
            best = torch.where(better, gain, best)
            end[better], where[better] = far[better], context[better]
        return end, where


def _neighbours(z: Tensor, train: Tensor, radius: float, rng: np.random.Generator) -> Tensor:
    """For each latent [N,Z] the rows i32 [N,K] of random ones of `train` within `radius` of it."""
    size = min(POOL, len(train))
    kept = min(KEPT, size)
    found = torch.empty(len(z), kept, dtype=torch.int32, device=z.device)
    for part, filled in zip(z.split(PART), found.split(PART), strict=True):
        pick: Int64 = rng.choice(len(train), size, replace=False)
        pool = train[torch.from_numpy(pick).to(train.device)]
        gap = torch.cdist(part, z[pool])
        order = torch.from_numpy(rng.random((len(part), len(pool)), dtype=np.float32)).to(gap)
        gap = torch.where(gap <= radius, order * radius, gap)  # within it in random order
        nearest, index = gap.topk(kept, largest=False)
        inside = (nearest <= radius).sum(1, keepdim=True).clamp_min(min(FEWEST, kept))
        place = torch.arange(kept, device=z.device) % inside  # too few: the same ones again
        filled.copy_(pool[index.gather(1, place)])
    return found
