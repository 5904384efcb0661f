"""Worker processes: any number gives the same results; one that is killed is replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from elast_cli.engine.base import K, R, T
from elast_cli.engine.relay import relayed, spawn
from elast_cli.errors import UnavailableError
from elast_cli.progress import Progress

MOST_DEATHS = 5  # pools lost before giving up


@dataclass(frozen=True)
class LocalEngine:
    """Worker processes on this machine; a single task at a time runs in this process."""

    workers: int = 1

    def each(self, task: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """`task(item)` of every item, as they complete.

        Raises:
            UnavailableError: workers keep being killed.
        """
        if self.workers == 1 or len(items) <= 1:
            yield from map(task, items)
            return
        left = dict(enumerate(items))
        for _ in range(MOST_DEATHS):
            try:
                with _pool(min(self.workers, len(left))) as pool:
                    futures = {pool.submit(task, item): place for place, item in left.items()}
                    for future in as_completed(futures):
                        result = future.result()
                        del left[futures[future]]
                        yield result
                return
            except BrokenProcessPool:
                continue
        raise _killed()

    def graph(
        self,
        needs: Mapping[K, Collection[K]],
        item: Callable[[K], T],
        task: Callable[[T], R],
    ) -> Iterator[tuple[K, R]]:
        """`task(item(key))` of every key, as they complete; a key's turn comes after all its needs.

        Raises:
            UnavailableError: workers keep being killed.
            ValueError: keys wait for one another.
        """
        left = dict(needs)
        deaths = 0
        while left:
            ready = [key for key in left if not any(need in left for need in left[key])]
            if not ready:
                raise ValueError(f"these wait for one another: {', '.join(map(str, left))}")
            if len(ready) == 1 or self.workers == 1:
                result = task(item(ready[0]))
                del left[ready[0]]
                yield ready[0], result
                continue
            try:
                yield from _in_parallel(left, item, task, self.workers)
            except BrokenProcessPool:
                deaths += 1
                if deaths == MOST_DEATHS:
                    raise _killed() from None

    def relayed(self, progress: Progress, tasks: int) -> AbstractContextManager[Progress]:
        """Progress that workers show here; itself if all tasks run in this process."""
        return relayed(progress, wanted=self.workers > 1 and tasks > 1)


def _in_parallel(
    left: dict[K, Collection[K]], item: Callable[[K], T], task: Callable[[T], R], workers: int
) -> Iterator[tuple[K, R]]:
    """Work on what is `left` until one key at most can be worked on; those done leave it."""
    with _pool(workers) as pool:
        running: dict[Future[R], K] = {}
        while True:
            busy = set(running.values())
            ready = [key for key in left if not any(need in left for need in left[key])]
            if len(ready) <= 1 and not running:
                return
            for key in [key for key in ready if key not in busy][: workers - len(running)]:
                running[pool.submit(task, item(key))] = key
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                result = future.result()
                key = running.pop(future)
                del left[key]
                yield key, result


def _killed() -> UnavailableError:
    return UnavailableError(
        f"{MOST_DEATHS} worker processes were killed (out of memory?); try fewer --workers"
    )


def usable_cores() -> int:
    """Processor cores that this process may use; all cores if the system does not say."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool that ends with the block, also after an error."""
    pool = ProcessPoolExecutor(workers, mp_context=spawn(), initializer=_begin_worker)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    pool.shutdown()


def _begin_worker() -> None:
    """One thread per library; leave Ctrl-C to the parent; end when the parent ends."""
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
