"""Progress of long work: a label, a total, and steps done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Protocol

Advance = Callable[[int], None]


class Progress(Protocol):
    """Display of progress and notes; the command line shows them on stderr."""

    def task(self, label: str, total: int, done: int = 0) -> AbstractContextManager[Advance]:
        """Open a bar of `total` steps; the yielded function advances it by n steps.

        Args:
            label: what is counted.
            total: steps of the whole task.
            done: those that an earlier run did; they do not count towards the rate.
        """
        ...

    def note(self, text: str) -> None:
        """Print one line."""
        ...


def ignore(_steps: int) -> None:
    """Count nothing."""


class Silent:
    """No display of progress: for workers, tests and library use."""

    @contextmanager
    def task(self, label: str, total: int, done: int = 0) -> Iterator[Advance]:
        """Accept steps and show nothing."""
        yield ignore

    def note(self, text: str) -> None:
        """Print nothing."""


@dataclass(frozen=True)
class Within:
    """Progress inside a task: the steps of all tasks that are opened here are steps of that one.

    Attributes:
        outer: where notes go.
        advance: of the task.
    """

    outer: Progress
    advance: Advance

    @contextmanager
    def task(self, label: str, total: int, done: int = 0) -> Iterator[Advance]:
        """Count steps towards the outer task."""
        yield self.advance

    def note(self, text: str) -> None:
        """Print one line."""
        self.outer.note(text)
