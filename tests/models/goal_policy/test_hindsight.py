"""Hindsight goals: which rows they are, and how often."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import chisquare

from elast_cli.data.dataset import Dataset
from elast_cli.models.goal_policy.config import GoalMix
from elast_cli.models.goal_policy.hindsight import Hindsight
from elast_cli.shapes import Int64
from tests.toys.datasets import columns
from tests.toys.goals import dataset_of

DRAWS = 20_000


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def uneven() -> Dataset:
    """Episodes of rows 0 to 2, 3 to 6, 7 and 8."""
    found = {k: v for k, v in columns().items() if k not in ("step_idx", "ep_idx")}
    return Dataset(**found, context=None)


def hindsight(dataset: Dataset) -> Hindsight:
    return Hindsight.of(dataset, dataset.starts(np.arange(dataset.episodes), 1))


def assert_shares(drawn: Int64, expected: dict[int, float]) -> None:
    """By a chi-square test at one in a thousand."""
    assert set(drawn.tolist()) <= set(expected)
    counts = [int((drawn == value).sum()) for value in expected]
    frequencies = np.array([*expected.values()]) * len(drawn)
    assert chisquare(counts, frequencies).pvalue > 1e-3


def test_future_goals_lie_behind_the_row_in_the_same_episode() -> None:
    dataset = uneven()
    every = hindsight(dataset)
    assert every.starts.tolist() == [0, 1, 3, 4, 5, 7]
    rows, random = every.rows(rng(), DRAWS), rng()
    for goals in (every.future(rows, random), every.soon(rows, random, 0.9)):
        assert (goals > rows).all()
        np.testing.assert_array_equal(dataset.episode[goals], dataset.episode[rows])


def test_rows_are_uniform_over_the_starts() -> None:
    every = hindsight(uneven())
    assert_shares(every.rows(rng(), DRAWS), dict.fromkeys(every.starts.tolist(), 1 / 6))


def test_future_goals_are_uniform_up_to_the_last_row_or_the_longest_way() -> None:
    every = hindsight(dataset_of(np.zeros((2, 10, 1))))
    rows = np.full(DRAWS, 14)
    assert_shares(every.future(rows, rng()), dict.fromkeys(range(15, 20), 1 / 5))
    assert_shares(every.future(rows, rng(), longest=3), dict.fromkeys(range(15, 18), 1 / 3))
    assert_shares(every.future(rows, rng(), longest=99), dict.fromkeys(range(15, 20), 1 / 5))


def test_goals_soon_are_geometric_and_what_is_left_goes_to_the_last_row() -> None:
    every = hindsight(dataset_of(np.zeros((1, 4, 1))))
    drawn = every.soon(np.zeros(DRAWS, np.int64), rng(), 0.8)
    assert_shares(drawn, {1: 0.2, 2: 0.16, 3: 0.64})


def test_goals_are_mixed_by_their_shares() -> None:
    every = hindsight(dataset_of(np.zeros((2, 3, 1))))  # transitions end in rows 1, 2, 4 and 5
    rows, future = np.full(DRAWS, 0), np.full(DRAWS, 3)
    mix = GoalMix(current=0.2, future=0.5, random=0.3)
    drawn = every.mixed(rows, future, mix, rng())
    assert_shares(drawn, {0: 0.2, 3: 0.5, **dict.fromkeys((1, 2, 4, 5), 0.3 / 4)})


def test_random_goals_are_states_of_the_own_episodes_alone() -> None:
    dataset = uneven()
    held_out = Hindsight.of(dataset, dataset.starts(np.array([1]), 1))
    rows = held_out.rows(rng(), 500)
    drawn = held_out.mixed(rows, rows, GoalMix(current=0, future=0, random=1), rng())
    assert set(drawn.tolist()) == {4, 5, 6}


def test_shares_that_do_not_add_up_are_refused() -> None:
    with pytest.raises(ValidationError, match=r"must add up to 1, not 0\.9"):
        GoalMix(current=0.2, future=0.5, random=0.2)
