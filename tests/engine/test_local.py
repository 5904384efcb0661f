from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from elast_cli.engine.local import MOST_DEATHS, each, usable_cores
from elast_cli.engine.relay import relayed
from elast_cli.errors import DataError, UnavailableError
from elast_cli.progress import Silent


class Notes(Silent):
    """Progress that remembers what was said."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def note(self, text: str) -> None:
        self.said.append(text)


def test_cores_are_counted_where_the_system_has_no_affinity(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert usable_cores() >= 1
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert usable_cores() == os.cpu_count()


def square(number: int) -> int:
    return number * number


def die_once(item: tuple[Path, int]) -> int:
    mark, number = item
    if number == 3 and not mark.exists():
        mark.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die(_number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def fail(number: int) -> int:
    raise DataError(f"item {number} is bad")


def tell(item: tuple[object, int]) -> int:
    progress, number = item
    with progress.task("work", 2) as advance:  # type: ignore[attr-defined]  # a Relay
        advance(2)
    progress.note(f"did {number}")  # type: ignore[attr-defined]  # a Relay
    return number


@pytest.mark.parametrize("workers", [1, 2])
def test_every_item_is_done_once(workers: int) -> None:
    assert sorted(each(square, range(5), workers=workers)) == [0, 1, 4, 9, 16]


def test_a_killed_worker_is_replaced(tmp_path: Path) -> None:
    items = [(tmp_path / "died", number) for number in range(8)]
    assert sorted(each(die_once, items, workers=2)) == list(range(8))
    assert (tmp_path / "died").exists()


def test_workers_that_keep_dying_are_an_error_with_a_way_out() -> None:
    with pytest.raises(UnavailableError, match=f"{MOST_DEATHS} worker processes.*--workers"):
        list(each(die, range(2), workers=2))


def test_an_error_in_a_worker_is_the_callers() -> None:
    with pytest.raises(DataError, match=r"item . is bad"):
        list(each(fail, range(2), workers=2))


def test_progress_of_workers_is_shown_by_the_parent() -> None:
    notes = Notes()
    with relayed(notes) as progress:
        list(each(tell, [(progress, 1), (progress, 2)], workers=2))
    assert sorted(notes.said) == ["did 1", "did 2"]
