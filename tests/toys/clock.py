"""Bounds on computing time that hold on a slower machine, and beside other programs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

ROOM = 4  # times as slow as the machine that a bound was set on


@contextmanager
def soon(seconds: float = 1) -> Iterator[None]:
    """Fail unless the block takes less CPU time than that, times ROOM."""
    began = time.process_time()
    yield
    assert time.process_time() - began < ROOM * seconds
