"""The intervals against hand numbers, worked examples from the literature, and scipy."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from elast_cli.evaluation.statistics import (
    mcnemar_exact,
    mean,
    newcombe_paired,
    standard_deviation,
    t_interval,
    wilson,
)

COUNTS = st.tuples(*[st.integers(0, 60)] * 4).filter(lambda table: sum(table) > 0)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # Newcombe (1998), Stat. Med. 17:857, table I, method 3
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (29, 29, 0.8830, 1.0),
    ],
)
def test_wilson_agrees_with_published_examples(
    successes: int, n: int, low: float, high: float
) -> None:
    got = wilson(successes, n)
    assert got[0] == pytest.approx(100 * low, abs=0.006)
    assert got[1] == pytest.approx(100 * high, abs=0.006)


@given(n=st.integers(1, 1000), data=st.data())
def test_wilson_agrees_with_scipy(n: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, n))
    confidence = data.draw(st.sampled_from([0.5, 0.9, 0.95, 0.99]))
    found = stats.binomtest(successes, n).proportion_ci(confidence, method="wilson")
    expected = (100 * found.low, 100 * found.high)
    assert wilson(successes, n, confidence=confidence) == pytest.approx(expected, abs=1e-9)


def test_wilson_agrees_with_its_closed_form_at_the_ends() -> None:
    z = 1.959963984540054
    assert wilson(0, 100) == pytest.approx((0.0, 100 * z**2 / (100 + z**2)))
    assert wilson(100, 100) == pytest.approx((100 * 100 / (100 + z**2), 100.0))
    assert wilson(0, 100)[0] == 0.0
    assert wilson(100, 100)[1] == 100.0


@given(n=st.integers(1, 500), data=st.data())
def test_wilson_covers_the_rate_and_mirrors(n: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, n))
    low, high = wilson(successes, n)
    assert 0.0 <= low <= 100.0 * successes / n + 1e-9
    assert 100.0 * successes / n - 1e-9 <= high <= 100.0
    assert low < high
    mirrored = wilson(n - successes, n)
    assert (100 - mirrored[1], 100 - mirrored[0]) == pytest.approx((low, high), abs=1e-9)


@pytest.mark.parametrize(("successes", "n"), [(0, 0), (-1, 5), (6, 5)])
def test_wilson_refuses_what_is_no_proportion(successes: int, n: int) -> None:
    with pytest.raises(ValueError, match=f"{successes} successes of {n}"):
        wilson(successes, n)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0])
def test_a_confidence_outside_0_and_1_is_refused(confidence: float) -> None:
    with pytest.raises(ValueError, match="confidence"):
        wilson(3, 5, confidence=confidence)


@pytest.mark.parametrize(
    ("both", "first", "second", "neither", "low", "high"),
    [
        # Cavo et al. (2012) in Fagerland, Lydersen & Laake, Statistical Analysis of Contingency
        # Tables, ch. 8: square-and-add interval of first - second
        (59, 6, 16, 80, -0.1186, -0.0046),
        # Bentur et al. (2009), the same chapter
        (1, 1, 7, 12, -0.507, -0.026),
        # Altman et al. (2000), Statistics with Confidence, table 6.2
        (14, 5, 0, 22, 0.011, 0.226),
    ],
)
def test_the_paired_interval_agrees_with_published_examples(
    both: int, first: int, second: int, neither: int, low: float, high: float
) -> None:
    got = newcombe_paired(both, second, first, neither)  # b - a = first - second
    digits = 0.006 if round(low, 3) != low else 0.06
    assert got == pytest.approx((100 * low, 100 * high), abs=digits)


@given(COUNTS)
def test_the_paired_interval_covers_the_difference_and_turns_with_the_sides(
    table: tuple[int, int, int, int],
) -> None:
    both, only_a, only_b, neither = table
    low, high = newcombe_paired(both, only_a, only_b, neither)
    difference = 100.0 * (only_b - only_a) / sum(table)
    assert -100.0 <= low <= difference + 1e-9
    assert difference - 1e-9 <= high <= 100.0
    turned = newcombe_paired(both, only_b, only_a, neither)
    assert (-turned[1], -turned[0]) == pytest.approx((low, high), abs=1e-9)


def test_the_paired_interval_is_not_degenerate_when_no_pair_disagrees() -> None:
    low, high = newcombe_paired(100, 0, 0, 0)
    assert low == pytest.approx(-high)
    assert 2.0 < high < 6.0


@pytest.mark.parametrize("table", [(0, 0, 0, 0), (3, -1, 2, 4)])
def test_the_paired_interval_refuses_what_is_no_table(table: tuple[int, int, int, int]) -> None:
    with pytest.raises(ValueError, match="no table of pairs"):
        newcombe_paired(*table)


def test_mcnemar_agrees_with_published_examples_and_hand_numbers() -> None:
    assert mcnemar_exact(1, 7) == pytest.approx(18 / 256)  # Bentur et al. (2009): 0.0703
    # Armitage & Berry (1994), p. 127
    assert mcnemar_exact(12, 2) == pytest.approx(0.0129, abs=5e-5)
    assert mcnemar_exact(0, 5) == pytest.approx(2 / 32)
    assert mcnemar_exact(0, 0) == 1.0
    assert mcnemar_exact(4, 4) == 1.0
    assert mcnemar_exact(0, 3000) == 0.0


@given(only_a=st.integers(0, 200), only_b=st.integers(0, 200))
def test_mcnemar_is_the_binomial_test_of_scipy(only_a: int, only_b: int) -> None:
    n = only_a + only_b
    expected = stats.binomtest(only_a, n, 0.5).pvalue if n else 1.0
    assert mcnemar_exact(only_a, only_b) == pytest.approx(expected, rel=1e-9)


@given(
    values=st.lists(st.floats(-1000, 1000), min_size=2, max_size=30),
    confidence=st.sampled_from([0.5, 0.95, 0.99]),
)
def test_the_t_interval_agrees_with_scipy(values: list[float], confidence: float) -> None:
    got = t_interval(values, confidence=confidence)
    assert got is not None
    spread = standard_deviation(values)
    assert spread is not None
    if spread == 0:
        assert got == (mean(values), mean(values))
        return
    scale = spread / math.sqrt(len(values))
    expected = stats.t.interval(confidence, len(values) - 1, loc=mean(values), scale=scale)
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_the_t_interval_agrees_with_a_hand_number() -> None:
    # mean 3, s = sqrt(2.5), t(4, .975) = 2.776445
    half = 2.776445105 * math.sqrt(2.5) / math.sqrt(5)
    assert t_interval([1, 2, 3, 4, 5]) == pytest.approx((3 - half, 3 + half))


def test_means_of_too_little_are_none() -> None:
    assert mean([]) is None
    assert standard_deviation([]) is None
    assert standard_deviation([2.0]) is None
    assert t_interval([2.0]) is None
    assert mean([1.0, 2.0]) == 1.5
    assert standard_deviation([1.0, 3.0]) == pytest.approx(math.sqrt(2))
