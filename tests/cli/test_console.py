from __future__ import annotations

import io
import threading

import pytest
from rich.console import Console

from elast_cli.cli.console import BarReporter, LineReporter
from elast_cli.cli.meter import Meter, duration, pace


class Time:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_rate_is_known_from_the_first_step_on() -> None:
    clock = Time()
    meter = Meter(10, clock=clock)
    assert (meter.rate(), meter.left(), pace(meter)) == (None, None, "")
    clock.now += 2
    meter.advance(1)
    assert (meter.rate(), meter.left()) == (0.5, 18)
    assert pace(meter) == "2.0 s each, 18 s left"
    clock.now += 1
    assert pace(meter) == "2.0 s each, 17 s left"


def test_steps_of_an_earlier_run_are_no_speed() -> None:
    clock = Time()
    meter = Meter(1000, 900, clock)
    clock.now += 1
    meter.advance(10)
    assert (meter.done, pace(meter)) == (910, "10.0/s, 9 s left")


def test_the_rate_is_that_of_the_last_half_minute() -> None:
    clock = Time()
    meter = Meter(100_000, clock=clock)
    for rate in (1, 50):
        for _ in range(60):
            clock.now += 1
            meter.advance(rate)
    assert meter.rate() == 50


def test_many_quick_steps_are_one_sample() -> None:
    clock = Time()
    meter = Meter(100_000, clock=clock)
    for _ in range(20_000):
        clock.now += 0.001
        meter.advance(1)
    assert meter.rate() == pytest.approx(1000)
    assert len(meter._samples) < 300


def test_steps_that_are_repeated_never_pass_the_total() -> None:
    meter = Meter(3, clock=Time())
    meter.advance(5)
    assert meter.done == 3


class Noted(LineReporter):
    """Keeps what it says, and when."""

    def __init__(self, clock: Time) -> None:
        super().__init__(clock)
        self.clock, self.said = clock, list[tuple[float, str]]()

    def note(self, text: str) -> None:
        self.said.append((self.clock.now - 100, text))


def test_lines_come_after_five_seconds_and_then_every_ten() -> None:
    clock = Time()
    reporter, meter = Noted(clock), Meter(100, 40, clock)

    def ended(seconds: float) -> bool:
        """A step each second but the first six."""
        for _ in range(round(seconds)):
            clock.now += 1
            meter.advance(1 if clock.now > 106 else 0)
        return clock.now > 130

    reporter.tell("work", meter, ended)
    assert reporter.said == [
        (5, "work: 40/100 (40 %), 5 s so far"),
        (15, "work: 49/100 (49 %), 1.7 s each, 1 min 25 s left"),
        (25, "work: 59/100 (59 %), 1.3 s each, 54 s left"),
    ]


def test_a_task_of_lines_ends_with_one_and_leaves_no_thread() -> None:
    clock, threads = Time(), threading.active_count()
    reporter = Noted(clock)
    with reporter.task("work", 3, 1) as advance:
        clock.now += 65
        advance(2)
    assert reporter.said == [(65, "work: 3/3 done in 1 min 5 s")]
    assert threading.active_count() == threads


def test_a_task_that_fails_says_no_more() -> None:
    reporter, threads = Noted(Time()), threading.active_count()
    with pytest.raises(ValueError, match="no"), reporter.task("work", 3):
        raise ValueError("no")
    assert (reporter.said, threading.active_count()) == ([], threads)


def test_bars_show_rate_and_time_left_after_one_step() -> None:
    clock, out = Time(), io.StringIO()
    console = Console(file=out, force_terminal=True, width=120)
    with BarReporter(console, clock).task("work", 10) as advance:
        clock.now += 2.3
        advance(1)
    assert "1/10" in out.getvalue()
    assert "2.3 s each, 21 s left" in out.getvalue()


def test_durations_read_well() -> None:
    shown = [duration(seconds) for seconds in (0.2, 42, 59.7, 185, 3725)]
    assert shown == ["0 s", "42 s", "1 min 0 s", "3 min 5 s", "1 h 2 min"]


def test_very_slow_steps_are_told_in_minutes() -> None:
    clock = Time()
    meter = Meter(3, clock=clock)
    clock.now += 90
    meter.advance(1)
    assert pace(meter) == "1 min 30 s each, 3 min 0 s left"
