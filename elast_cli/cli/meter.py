"""How fast a task goes, and how long it will take."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

Clock = Callable[[], float]
WINDOW = 30.0  # seconds that a rate is measured over
GRAIN = 0.1  # seconds between two samples of a window


class Meter:
    """Steps of one task, and their rate over the last 30 seconds.

    The rate is known from the first step on. Steps of an earlier run do not count towards it.
    """

    def __init__(self, total: int, done: int = 0, clock: Clock = time.monotonic) -> None:
        self.total = total
        self._clock = clock
        self._began = clock()
        self._samples = deque([(self._began, done)])  # at least the last one outside the window
        self._lock = threading.Lock()  # bars are drawn by a thread of their own

    def advance(self, steps: int) -> None:
        """Count steps."""
        with self._lock:
            now, done = self._clock(), self._samples[-1][1] + steps
            if len(self._samples) > 1 and self._samples[-1][0] - self._samples[-2][0] < GRAIN:
                self._samples.pop()
            self._samples.append((now, done))
            while len(self._samples) > 2 and self._samples[1][0] <= now - WINDOW:
                self._samples.popleft()

    @property
    def done(self) -> int:
        """Steps so far; never more than all, though a worker that is replaced repeats some."""
        return min(self._samples[-1][1], self.total)

    @property
    def elapsed(self) -> float:
        """Seconds since the task began."""
        return self._clock() - self._began

    def rate(self) -> float | None:
        """Steps a second; None before the first step."""
        with self._lock:
            (began, before), (ended, after) = self._samples[0], self._samples[-1]
        return (after - before) / (ended - began) if after > before and ended > began else None

    def left(self) -> float | None:
        """Seconds until the end at this rate; None before the first step."""
        rate = self.rate()
        if rate is None:
            return None
        since = self._clock() - self._samples[-1][0]
        return max((self.total - self.done) / rate - since, 0.0)


def pace(meter: Meter) -> str:
    """`24.1/s, 57 s left`, or `2.3 s each, 57 s left` for less than one step a second."""
    rate, left = meter.rate(), meter.left()
    if rate is None or left is None:
        return ""
    return f"{_speed(rate)}, {duration(left)} left"


def duration(seconds: float) -> str:
    """`42 s`, `3 min 5 s`, `1 h 2 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _speed(rate: float) -> str:
    if rate >= 1:
        return f"{rate:.1f}/s"
    return f"{1 / rate:.1f} s each" if rate > 1 / 60 else f"{duration(1 / rate)} each"
