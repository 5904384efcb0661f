"""Worker processes: any number gives the same results; one that is killed is replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any, Protocol, TypeVar

from elast_cli.errors import UnavailableError
from elast_cli.progress import Advance, Progress

T = TypeVar("T")
R = TypeVar("R")

MOST_DEATHS = 5  # pools lost before giving up
_SPAWN = multiprocessing.get_context("spawn")  # fork is unsafe once torch or a renderer has threads


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
    pool = ProcessPoolExecutor(workers, mp_context=_SPAWN, initializer=_begin_worker)
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


# --- progress of workers ---------------------------------------------------------------------


class _Queue(Protocol):
    """The part of a queue that both ends need."""

    def put(self, item: Any) -> None:
        """Send."""
        ...

    def get(self) -> Any:
        """Wait for the next item."""
        ...


class Relay:
    """Progress in a worker that is shown by its parent."""

    SEND_EVERY = 0.2  # seconds

    def __init__(self, queue: _Queue) -> None:
        self._queue = queue
        self._tasks = 0

    def task(self, label: str, total: int) -> AbstractContextManager[Advance]:
        """Show a bar in the parent."""
        return self._task(label, total)

    @contextmanager
    def _task(self, label: str, total: int) -> Iterator[Advance]:
        self._tasks += 1
        key = (os.getpid(), threading.get_ident(), self._tasks)
        waiting, sent = 0, time.monotonic()

        def advance(steps: int) -> None:
            nonlocal waiting, sent
            waiting += steps
            if time.monotonic() - sent >= self.SEND_EVERY:
                self._queue.put(("advance", key, waiting))
                waiting, sent = 0, time.monotonic()

        self._queue.put(("open", key, (label, total)))
        try:
            yield advance
        finally:
            self._queue.put(("advance", key, waiting))
            self._queue.put(("close", key, None))

    def note(self, text: str) -> None:
        """Say one line in the parent."""
        self._queue.put(("note", None, text))


@contextmanager
def relayed(progress: Progress) -> Iterator[Relay]:
    """Progress that can be sent to workers and ends up in `progress`."""
    with _SPAWN.Manager() as manager:
        queue = manager.Queue()
        listener = threading.Thread(target=_listen, args=(queue, progress), daemon=True)
        listener.start()
        try:
            yield Relay(queue)
        finally:
            queue.put(("end", None, None))
            listener.join()


def _listen(queue: _Queue, progress: Progress) -> None:
    """Show what workers send until the end is sent."""
    open_tasks: dict[Any, tuple[ExitStack, Advance]] = {}
    while True:
        what, key, value = queue.get()
        if what == "end":
            break
        if what == "note":
            progress.note(value)
        elif what == "open":
            stack = ExitStack()
            open_tasks[key] = stack, stack.enter_context(progress.task(*value))
        elif what == "advance":
            open_tasks[key][1](value)
        elif what == "close":
            open_tasks.pop(key)[0].close()
    for stack, _ in open_tasks.values():
        stack.close()
