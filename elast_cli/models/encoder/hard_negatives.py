"""Which windows of the data make a batch for φ: random ones, or hard negatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elast_cli.shapes import Float32, Int64

POOL = 20_000  # windows that are encoded at each search


class Starts:
    """Rows at which windows may start; batches of them."""

    def __init__(self, rows: Int64) -> None:
        """Take rows [M]."""
        self.rows = rows

    def batch(self, rng: np.random.Generator, size: int) -> Int64:
        """Rows [size], uniform with replacement."""
        return self.rows[rng.integers(len(self.rows), size=size)]


class HardNegatives:
    """Groups of windows that end in states which φ, at this point of training, hardly tells apart.

    Where all windows of a batch are drawn at random, telling them apart asks for little: where a
    cable's head is says which of 256 cables it is, and φ learns little about the rest of it.
    Such groups are negatives that ask for just what φ still confuses.

    The groups are searched again every `refresh` batches.

    After a resumption the search comes with the first batch: a run that was interrupted at a
    multiple of `refresh` draws the same batches as one that was not.
    """

    def __init__(
        self, starts: Int64, encode: Callable[[Int64], Float32], *, group: int, refresh: int
    ) -> None:
        """Take windows' first rows [M] and φ on the windows that start there: [P] -> [P,Z]."""
        self.starts, self.encode = starts, encode
        self.group, self.refresh = group, refresh
        self.drawn = 0
        self.groups: Int64 = np.empty((0, group), np.int64)

    def batch(self, rng: np.random.Generator, size: int) -> Int64:
        """Rows [size], in groups as far as whole groups fit; the rest is drawn at random."""
        if self.drawn % self.refresh == 0:
            self.groups = self._search(rng, self.refresh * size // self.group)
        self.drawn += 1
        chosen = self.groups[rng.integers(len(self.groups), size=size // self.group)].ravel()
        rest = self.starts[rng.integers(len(self.starts), size=size - len(chosen))]
        return np.concatenate([chosen, rest])

    def _search(self, rng: np.random.Generator, groups: int) -> Int64:
        """At most `groups` groups [G,group] of those nearest to each other in a random pool."""
        from scipy.spatial import cKDTree  # slow to import: only where it is used

        size = min(POOL, len(self.starts))
        pool = rng.choice(self.starts, size, replace=False)
        z = self.encode(pool)
        anchors = rng.choice(size, max(1, min(groups, size)), replace=False)
        _, near = cKDTree(z).query(z[anchors], k=min(self.group, size))
        found: Int64 = pool[near.reshape(len(anchors), -1)]
        return found
