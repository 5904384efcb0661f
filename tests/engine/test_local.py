from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from elast_cli.engine.base import Engine
from elast_cli.engine.local import MOST_DEATHS, LocalEngine, usable_cores
from elast_cli.errors import DataError, UnavailableError


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


@pytest.mark.parametrize("workers", [1, 2])
def test_every_item_is_done_once(workers: int) -> None:
    assert sorted(LocalEngine(workers).each(square, range(5))) == [0, 1, 4, 9, 16]


def test_a_killed_worker_is_replaced(tmp_path: Path) -> None:
    items = [(tmp_path / "died", number) for number in range(8)]
    assert sorted(LocalEngine(2).each(die_once, items)) == list(range(8))
    assert (tmp_path / "died").exists()


def test_workers_that_keep_dying_are_an_error_with_a_way_out() -> None:
    with pytest.raises(UnavailableError, match=f"{MOST_DEATHS} worker processes.*--workers"):
        list(LocalEngine(2).each(die, range(2)))


def test_an_error_in_a_worker_is_the_callers() -> None:
    with pytest.raises(DataError, match=r"item . is bad"):
        list(LocalEngine(2).each(fail, range(2)))


def test_keys_wait_for_what_they_need() -> None:
    needs = {"a": [], "b": ["a", "elsewhere"], "c": ["a"], "d": ["b", "c"]}
    for workers in (1, 2):
        made: dict[str, int] = {}

        def item(key: str, made: dict[str, int] = made) -> int:
            return 1 + sum(made[need] for need in needs[key] if need in needs)

        for key, result in LocalEngine(workers).graph(needs, item, square):
            made[key] = result
        assert made == {"a": 1, "b": 4, "c": 4, "d": 81}


DIAMONDS = {"a": [], "b": ["a"], "c": ["a"], "d": ["b", "c"], "e": ["d"], "f": ["d"], "g": []}


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_any_number_of_workers_makes_the_same_in_an_order_that_respects_needs(workers: int) -> None:
    made: dict[str, int] = {}
    asked: list[str] = []

    def item(key: str) -> int:
        assert all(need in made for need in DIAMONDS[key])
        asked.append(key)
        return ord(key) + sum(made[need] for need in DIAMONDS[key]) % 97

    for key, result in LocalEngine(workers).graph(DIAMONDS, item, square):
        assert key not in made
        made[key] = result
    assert sorted(asked) == sorted(DIAMONDS)
    expected: dict[str, int] = {}
    for key, needs in DIAMONDS.items():
        expected[key] = (ord(key) + sum(expected[need] for need in needs) % 97) ** 2
    assert made == expected


def process(_number: int) -> int:
    return os.getpid()


def test_a_key_that_is_alone_is_worked_on_in_this_process_and_two_are_not() -> None:
    chain = {"a": [], "b": ["a"], "c": ["b"]}
    found = dict(LocalEngine(2).graph(chain, len, process))
    assert set(found.values()) == {os.getpid()}
    fork = {"a": [], "b": ["a"], "c": ["a"], "d": ["b", "c"]}
    found = dict(LocalEngine(2).graph(fork, len, process))
    assert (found["a"], found["d"]) == (os.getpid(), os.getpid())
    assert os.getpid() not in (found["b"], found["c"])
    assert set(dict(LocalEngine(1).graph(fork, len, process)).values()) == {os.getpid()}


def test_a_key_whose_worker_was_killed_is_given_to_another(tmp_path: Path) -> None:
    needs = {number: [0] if number else [] for number in range(6)}
    made: dict[int, int] = {}
    for key, result in LocalEngine(2).graph(needs, lambda n: (tmp_path / "died", n), die_once):
        assert key not in made
        made[key] = result
    assert made == {number: number for number in range(6)}
    assert (tmp_path / "died").exists()


def test_workers_that_keep_dying_at_a_graph_are_an_error_with_a_way_out() -> None:
    with pytest.raises(UnavailableError, match=f"{MOST_DEATHS} worker processes.*--workers"):
        list(LocalEngine(2).graph({1: [], 2: []}, int, die))


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_key_is_the_callers_and_ends_the_graph(workers: int) -> None:
    with pytest.raises(DataError, match=r"item . is bad"):
        list(LocalEngine(workers).graph({1: [], 2: []}, int, fail))


def test_keys_that_wait_for_one_another_are_an_error() -> None:
    with pytest.raises(ValueError, match="wait for one another: a, b"):
        list(LocalEngine().graph({"a": ["b"], "b": ["a"]}, len, square))


def test_the_local_engine_offers_what_stages_ask_of_an_engine() -> None:
    engine: Engine = LocalEngine(2)
    assert engine.workers == 2


def test_workers_import_nothing_from_the_working_directory(tmp_path: Path) -> None:
    """A file that is named like a library, in a folder where somebody happens to stand."""
    script, here = tmp_path / "script" / "run.py", tmp_path / "here"
    script.parent.mkdir()
    here.mkdir()
    script.write_text(
        "from elast_cli.engine.local import LocalEngine\n"
        "if __name__ == '__main__':\n"
        "    print(sorted(LocalEngine(2).each(abs, [1, -2])))\n"
    )
    for name in ("pickle", "queue", "random", "socket", "struct", "tempfile"):
        (here / f"{name}.py").write_text(f"open({str(tmp_path / name)!r}, 'w')")
    ran = subprocess.run(
        [sys.executable, str(script)], cwd=here, capture_output=True, text=True, timeout=120
    )
    assert ran.stdout == "[1, 2]\n", ran.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["here", "script"]
