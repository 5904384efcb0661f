"""Paired differences of two evaluations."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from elast_cli.errors import DataError
from elast_cli.evaluation.comparison import compare, comparison_table
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.evaluation.statistics import newcombe_paired, t_interval


def episodes(outcomes: list[int | None], **changes: Any) -> list[EpisodeRow]:
    """Episodes by steps to success, None for a failure."""
    fields: dict[str, Any] = {"env": "block-s", "level": "hard", "method": "elast", "train_seed": 0}
    fields |= {"seed": 7, "shortest": 40, "plans": 1, "plan_s": 1.0} | changes
    return [
        EpisodeRow(
            **fields,
            episode_ix=index,
            success=steps is not None,
            steps=steps,
            network_calls_per_step=1.0,
            held=steps is not None,
        )
        for index, steps in enumerate(outcomes)
    ]


def test_a_comparison_agrees_with_hand_numbers() -> None:
    rows_a = episodes([50, 60, None, None, 40, None])
    rows_b = episodes([48, 50, 44, 45, None])
    seed, total = compare(rows_a, rows_b)
    assert (seed.train_seed, total.train_seed) == (0, None)
    assert (total.n_pairs, total.unpaired_a, total.unpaired_b) == (5, 1, 0)
    assert (total.both, total.only_a, total.only_b) == (2, 1, 2)
    assert total.difference == 20.0
    assert total.ci95 == newcombe_paired(2, 1, 2, 0)
    assert total.mcnemar_p == 1.0
    assert total.steps_difference == -6.0
    assert total.steps_ci95 == t_interval([-2.0, -10.0])


def test_pairs_are_made_within_a_training_seed_and_pooled_over_them() -> None:
    rows_a = episodes([50, None], train_seed=0) + episodes([None, None], train_seed=1)
    rows_b = episodes([50, 40], train_seed=1) + episodes([None, 50], train_seed=0)
    by_seed = {row.train_seed: row for row in compare(rows_a, rows_b)}
    assert by_seed[0].difference == 0.0
    assert by_seed[1].difference == 100.0
    assert by_seed[None].difference == 50.0
    assert by_seed[None].n_pairs == 4


def test_turning_the_sides_turns_every_sign() -> None:
    rows_a, rows_b = episodes([50, None, 40]), episodes([None, 44, 47])
    there, back = compare(rows_a, rows_b)[-1], compare(rows_b, rows_a)[-1]
    assert there.difference == -back.difference
    assert there.ci95 == pytest.approx((-back.ci95[1], -back.ci95[0]))
    assert there.mcnemar_p == back.mcnemar_p
    assert there.steps_difference == 7.0
    assert back.steps_difference == -7.0


def test_shared_methods_are_compared_with_themselves() -> None:
    rows_a = episodes([50]) + episodes([None], method="random")
    rows_b = episodes([40], method="elast") + episodes([70], method="cpc-cem")
    assert {(row.method_a, row.method_b) for row in compare(rows_a, rows_b)} == {("elast", "elast")}


def test_two_single_methods_are_compared_with_one_another() -> None:
    total = compare(episodes([50]), episodes([None], method="cpc-cem"))[-1]
    assert (total.method_a, total.method_b) == ("elast", "cpc-cem")
    assert total.difference == -100.0
    assert total.steps_difference is None


@pytest.mark.parametrize(
    "changes",
    [{"seed": 8}, {"train_seed": 1}, {"env": "cable"}, {"level": "medium"}],
)
def test_evaluations_of_other_scenarios_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(DataError, match=r"nothing to compare.*elast@block-s/hard") as caught:
        compare(episodes([50]), episodes([50], **changes))
    assert "\n" not in str(caught.value)


def test_an_evaluation_without_episodes_is_refused() -> None:
    with pytest.raises(DataError, match="B has no episode"):
        compare(episodes([50]), [])


def test_the_table_names_both_methods_and_signs_the_difference() -> None:
    rows = compare(episodes([50, 40, 45]), episodes([None, 44, 46], method="cpc-cem"))
    console = Console(width=160, file=io.StringIO(), record=True)
    console.print(comparison_table(rows))
    text = console.export_text()
    assert "elast -> cpc-cem" in text
    assert "-33.3" in text
    assert "+2.5" in text
