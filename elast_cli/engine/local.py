"""Worker processes: any number gives the same results; one that is killed is replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from elast_cli.errors import UnavailableError

T = TypeVar("T")
R = TypeVar("R")
MOST_DEATHS = 5  # pools lost before giving up
SPAWN = multiprocessing.get_context("spawn")  # fork is unsafe once torch or a renderer has threads


def each(task: Callable[[T], R], items: Sequence[T], *, workers: int) -> Iterator[R]:
    """`task(item)` of every item, as they complete; in this process if `workers` is 1.

    An item whose worker was killed is given to another one, so tasks must bear a repetition.

    Raises:
        UnavailableError: workers keep being killed.
    """
    if workers == 1 or len(items) <= 1:
        yield from map(task, items)
        return
    left = dict(enumerate(items))
    for _ in range(MOST_DEATHS):
        try:
            with _pool(min(workers, len(left))) as pool:
                futures = {pool.submit(task, item): place for place, item in left.items()}
                for future in as_completed(futures):
                    result = future.result()
                    del left[futures[future]]
                    yield result
            return
        except BrokenProcessPool:
            continue
    raise UnavailableError(
        f"{MOST_DEATHS} worker processes were killed (out of memory?); try fewer --workers"
    )


def usable_cores() -> int:
    """Processor cores that this process may use, where the system tells; else all there are."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool that does not outlive the block, whatever ends it."""
    pool = ProcessPoolExecutor(workers, mp_context=SPAWN, initializer=_begin_worker)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    pool.shutdown()


def _begin_worker() -> None:
    """One thread for every library; Ctrl-C is the parent's business; die when the parent does."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
