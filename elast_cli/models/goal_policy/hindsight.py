"""Hindsight goals: states that the data reached, taken as if they had been the goal.

The only place where goals for training are drawn. Rows are rows of the dataset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elast_cli.data.dataset import Dataset
from elast_cli.models.goal_policy.config import GoalMix
from elast_cli.shapes import Int64


@dataclass(frozen=True)
class Hindsight:
    """Goals for the transitions that start at some rows.

    Attributes:
        starts: rows at which a transition starts [M].
        last: last row of the episode that each row of the dataset lies in [N].
    """

    starts: Int64
    last: Int64

    @classmethod
    def of(cls, dataset: Dataset, starts: Int64) -> Hindsight:
        """Goals for the transitions of a dataset that start at `starts` [M]."""
        last = dataset.ep_offset + dataset.ep_len - 1
        return cls(starts, last[dataset.episode])

    def rows(self, rng: np.random.Generator, size: int) -> Int64:
        """Starts of transitions [size], uniform with replacement."""
        return self.starts[rng.integers(len(self.starts), size=size)]

    def future(self, rows: Int64, rng: np.random.Generator, *, longest: int | None = None) -> Int64:
        """Goals [M] uniform over the later rows of the same episode.

        With `longest`, only the next `longest` rows count.

        Args:
            rows: i64 [M]; none is the last one of its episode.
            rng: draws the goals.
            longest: most steps to a goal.

        Returns:
            Rows i64 [M].
        """
        last = self.last[rows]
        if longest is not None:
            last = np.minimum(last, rows + longest)
        return rng.integers(rows + 1, last + 1)

    def soon(self, rows: Int64, rng: np.random.Generator, discount: float) -> Int64:
        """Goals [M] a geometric number of steps ahead, or the last row if the episode ends before.

        The number k ≥ 1 has probability (1 - γ) γ^(k - 1), with γ the `discount`.

        Args:
            rows: i64 [M]; none is the last one of its episode.
            rng: draws the goals.
            discount: γ, in (0, 1).

        Returns:
            Rows i64 [M].
        """
        ahead = rng.geometric(1 - discount, size=len(rows))
        goals: Int64 = np.minimum(rows + ahead, self.last[rows])
        return goals

    def mixed(self, rows: Int64, future: Int64, mix: GoalMix, rng: np.random.Generator) -> Int64:
        """Goals [M] of three kinds: `rows` themselves, `future` [M], and random ones.

        A random goal is any state that a transition of `starts` leads to. Its episode may have
        another context: then the goal may be one that nothing in this context leads to.

        Args:
            rows: i64 [M].
            future: rows of later states, i64 [M].
            mix: shares of the three kinds.
            rng: draws the kinds and the random goals.

        Returns:
            Rows i64 [M].
        """
        kind = rng.choice(3, size=len(rows), p=np.array(mix.shares) / sum(mix.shares))
        goals: Int64 = np.choose(kind, [rows, future, self.rows(rng, len(rows)) + 1])
        return goals
