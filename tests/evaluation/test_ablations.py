"""Lines of an ablation's table: paired with the method as it is, beside the paper's figures."""

from __future__ import annotations

from elast_cli.evaluation.ablations import line, markdown
from elast_cli.evaluation.documents import csv_text
from elast_cli.evaluation.rows import EpisodeRow
from elast_cli.evaluation.statistics import mcnemar_exact
from tests.toys.episodes import episode

WHERE = ("block-s", "hard")


def rows(successes: list[bool], **changes: object) -> list[EpisodeRow]:
    """One episode a success or failure; successes take 40 steps."""
    return [
        episode(i, success=ok, steps=40 if ok else None, held=False, **changes)
        for i, ok in enumerate(successes)
    ]


AS_IT_IS = rows([True] * 8)
CHANGED = rows([True] * 2 + [False] * 6)


def test_a_change_is_compared_on_the_same_scenarios() -> None:
    found = line("elast", "no rewiring", WHERE, CHANGED, AS_IT_IS, "no-rewire")
    assert found.overall is not None
    assert found.overall.pc_success == 25
    assert found.against is not None
    assert (found.against.difference, found.against.only_a) == (-75, 6)
    assert found.against.mcnemar_p == mcnemar_exact(6, 0)
    assert found.paper == "96 → 40, 36 → 93 steps"
    record = found.record("quick")
    assert (record["success"], record["difference"], record["steps"]) == (25, -75, 40)
    assert found.cells[3].startswith("25.0 [")


def test_the_method_as_it_is_and_a_failed_evaluation_are_compared_with_nothing() -> None:
    base = line("elast", "as it is", WHERE, AS_IT_IS, [])
    failed = line("elast", "no rewiring", WHERE, [], AS_IT_IS, "no-rewire")
    assert (base.against, failed.against, failed.overall) == (None, None, None)
    assert failed.cells[3:8] == ["failed", "-", "-", "-", "-"]
    assert failed.record("quick")["success"] is None


def test_other_training_seeds_do_not_pair() -> None:
    other = rows([True] * 8, train_seed=1)
    assert line("elast", "x", WHERE, other, AS_IT_IS).against is None


def test_the_documents_hold_one_row_a_line() -> None:
    lines = [
        line("elast", "as it is", WHERE, AS_IT_IS, []),
        line("elast", "no rewiring", WHERE, CHANGED, AS_IT_IS, "no-rewire"),
    ]
    text = markdown(lines, "block-s", "quick", [0])
    table = [row for row in text.splitlines() if row.startswith("|")]
    assert len(table) == 2 + len(lines)
    assert len({row.count("|") for row in table}) == 1
    assert "96 → 40" in table[-1]
    records = csv_text([found.record("quick") for found in lines]).splitlines()
    assert len(records) == 1 + len(lines)
    assert records[0].startswith("method,change,env,level,preset,success,")
