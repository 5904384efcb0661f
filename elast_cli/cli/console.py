"""Progress on stderr: bars with rate and time left, or plain lines without a terminal."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from elast_cli.cli.meter import Clock, Meter, duration, pace
from elast_cli.progress import Advance, Progress, Silent

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars

FIRST_LINE = 5.0  # seconds until the first plain line of a task
LINE_EVERY = 10.0  # seconds between two plain lines of one task


def reporter(*, quiet: bool) -> Progress:
    """The progress display that suits stderr: bars on a terminal, else lines."""
    if quiet:
        return Silent()
    return BarReporter() if sys.stderr.isatty() else LineReporter()


class LineReporter:
    """Plain lines, for logs: one after five seconds a task, one every ten, one when it ends."""

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock

    @contextmanager
    def task(self, label: str, total: int, done: int = 0) -> Iterator[Advance]:
        """Count steps towards `total`."""
        meter, ended = Meter(total, done, self._clock), threading.Event()
        teller = threading.Thread(target=self.tell, args=(label, meter, ended.wait), daemon=True)
        teller.start()
        try:
            yield meter.advance
        finally:
            ended.set()
            teller.join()
        self.note(f"{label}: {meter.done}/{total} done in {duration(meter.elapsed)}")

    def tell(self, label: str, meter: Meter, ended: Callable[[float], bool]) -> None:
        """Report the progress of a task until it ends.

        Args:
            label: what is counted.
            meter: of the task.
            ended: waits so many seconds; whether the task ended before that.
        """
        pause = FIRST_LINE
        while not ended(pause):
            self.note(_line(label, meter))
            pause = LINE_EVERY

    def note(self, text: str) -> None:
        """Print one line."""
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


class BarReporter:
    """Progress bars, one below another if several tasks run at a time."""

    def __init__(self, console: Console | None = None, clock: Clock = time.monotonic) -> None:
        self._lock = threading.Lock()
        self._console, self._clock = console, clock
        self._bars: Bars | None = None
        self._open = 0

    @contextmanager
    def task(self, label: str, total: int, done: int = 0) -> Iterator[Advance]:
        """Show a bar until the context ends."""
        meter = Meter(total, done, self._clock)
        with self._lock:
            if self._bars is None:
                self._bars = _bars(self._console)
                self._bars.start()
            bars, self._open = self._bars, self._open + 1
            bar = bars.add_task(label, total=total, completed=done, meter=meter)

        def advance(steps: int) -> None:
            meter.advance(steps)
            bars.update(bar, completed=meter.done)

        try:
            yield advance
        finally:
            with self._lock:
                self._open -= 1
                if self._open == 0:
                    bars.stop()
                    self._bars = None

    def note(self, text: str) -> None:
        """Print one line above the bars."""
        if self._bars is not None:
            self._bars.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            sys.stderr.write(f"{text}\n")


def _bars(console: Console | None) -> Bars:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        ProgressColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.progress import Progress as Bars
    from rich.text import Text

    class Pace(ProgressColumn):
        """Rate and time left; both from the first step on, where rich asks for two."""

        max_refresh = 0.5

        def render(self, task: Task) -> Text:
            return Text("" if task.finished else pace(task.fields["meter"]))

    return Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        Pace(),
        console=console or Console(stderr=True),
    )


def _line(label: str, meter: Meter) -> str:
    share = 100 * meter.done / max(meter.total, 1)
    how = pace(meter) or f"{duration(meter.elapsed)} so far"
    return f"{label}: {meter.done}/{meter.total} ({share:.0f} %), {how}"
