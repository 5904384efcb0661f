"""What long work tells whoever is watching: a label, a total, and steps done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

Advance = Callable[[int], None]


class Progress(Protocol):
    """Sink for progress and remarks; the command line shows them on stderr."""

    def task(self, label: str, total: int) -> AbstractContextManager[Advance]:
        """Open a bar of `total` steps; the yielded function advances it by n steps."""
        ...

    def note(self, text: str) -> None:
        """Say one line."""
        ...


class Silent:
    """Progress that nobody watches: workers, tests and library use."""

    @contextmanager
    def task(self, label: str, total: int) -> Iterator[Advance]:
        """Accept steps and show nothing."""

        def advance(_steps: int) -> None:
            return

        yield advance

    def note(self, text: str) -> None:
        """Say nothing."""
