"""What people see on stderr: progress bars with rate and time left; plain lines without a TTY."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

from elast_cli.progress import Advance, Progress, Silent

if TYPE_CHECKING:
    from rich.progress import Progress as Bars

LINE_EVERY = 10.0  # seconds between two plain lines of one task


def reporter(*, quiet: bool) -> Progress:
    """The sink of progress and remarks that suits where stderr goes."""
    if quiet:
        return Silent()
    return BarReporter() if sys.stderr.isatty() else LineReporter()


class LineReporter:
    """Plain lines, for logs: one every ten seconds a task, and one when it ends."""

    def task(self, label: str, total: int) -> AbstractContextManager[Advance]:
        """Count steps towards `total`."""
        return self._task(label, total)

    @contextmanager
    def _task(self, label: str, total: int) -> Iterator[Advance]:
        began = shown = time.monotonic()
        done, first = 0, 0

        def advance(steps: int) -> None:
            nonlocal done, shown, first
            first = steps if done == 0 else first  # a resumed run's start is no speed
            done += steps
            now = time.monotonic()
            if now - shown >= LINE_EVERY:
                shown = now
                self.note(_line(label, done, total, (done - first) / (now - began)))

        yield advance
        seconds = time.monotonic() - began
        self.note(f"{label}: {done}/{total} done in {_duration(seconds)}")

    def note(self, text: str) -> None:
        """Say one line."""
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


class BarReporter:
    """Bars that redraw themselves; those of several tasks at a time stand below one another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._bars: Bars | None = None
        self._open = 0

    def task(self, label: str, total: int) -> AbstractContextManager[Advance]:
        """Show a bar until the context ends."""
        return self._task(label, total)

    @contextmanager
    def _task(self, label: str, total: int) -> Iterator[Advance]:
        with self._lock:
            if self._bars is None:
                self._bars = _bars()
                self._bars.start()
            bars, self._open = self._bars, self._open + 1
            bar = bars.add_task(label, total=total)
        try:
            yield lambda steps: bars.advance(bar, steps)
        finally:
            with self._lock:
                self._open -= 1
                if self._open == 0:
                    bars.stop()
                    self._bars = None

    def note(self, text: str) -> None:
        """Say one line, above the bars."""
        if self._bars is not None:
            self._bars.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            sys.stderr.write(f"{text}\n")


def _bars() -> Bars:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        ProgressColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars
    from rich.text import Text

    class Rate(ProgressColumn):
        """Steps a second."""

        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.1f}/s" if speed else "")

    return Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


def _line(label: str, done: int, total: int, rate: float) -> str:
    left = f", {_duration((total - done) / rate)} left" if rate > 0 else ""
    return f"{label}: {done}/{total} ({100 * done / max(total, 1):.0f} %), {rate:.1f}/s{left}"


def _duration(seconds: float) -> str:
    """`42 s`, `3 min 5 s`, `1 h 2 min`."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
