from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from elast_cli.engine.local import LocalEngine
from elast_cli.progress import Advance, Progress, Within


class Kept:
    """Progress that remembers what it was told."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.steps: dict[str, int] = {}
        self.open: list[tuple[str, int, int]] = []

    @contextmanager
    def task(self, label: str, total: int, done: int = 0) -> Iterator[Advance]:
        self.open.append((label, total, done))

        def advance(steps: int) -> None:
            self.steps[label] = self.steps.get(label, 0) + steps

        yield advance

    def note(self, text: str) -> None:
        self.said.append(text)


def work(item: tuple[Progress, int]) -> int:
    progress, number = item
    with progress.task(f"work {number}", 4, 1) as advance:
        advance(2)
        advance(1)
    progress.note(f"did {number}")
    return number


def test_progress_of_workers_is_shown_by_the_parent() -> None:
    kept, engine = Kept(), LocalEngine(2)
    with engine.relayed(kept, 2) as progress:
        list(engine.each(work, [(progress, 1), (progress, 2)]))
    assert sorted(kept.said) == ["did 1", "did 2"]
    assert sorted(kept.open) == [("work 1", 4, 1), ("work 2", 4, 1)]
    assert kept.steps == {"work 1": 3, "work 2": 3}


def test_tasks_within_a_task_count_towards_it() -> None:
    kept, engine = Kept(), LocalEngine(2)
    with (
        kept.task("all", 6) as advance,
        engine.relayed(Within(kept, advance), 2) as progress,
    ):
        list(engine.each(work, [(progress, 1), (progress, 2)]))
    assert kept.open == [("all", 6, 0)]
    assert kept.steps == {"all": 6}
    assert sorted(kept.said) == ["did 1", "did 2"]


def test_a_single_task_needs_no_relay() -> None:
    kept = Kept()
    for engine, tasks in ((LocalEngine(1), 5), (LocalEngine(4), 1)):
        with engine.relayed(kept, tasks) as progress:
            assert progress is kept
