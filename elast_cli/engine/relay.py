"""Progress of worker processes, shown by their parent."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any, Protocol

from elast_cli.progress import Advance, Progress

SAFE_PATH = "PYTHONSAFEPATH"


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep a new process from importing modules of the working directory, such as `random.py`."""
    kept = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        del os.environ[SAFE_PATH]
        if kept is not None:
            os.environ[SAFE_PATH] = kept


class _Worker(SpawnProcess):
    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:  # its name in the library
        with _safe_path():
            return SpawnProcess._Popen(process_obj)


class _Spawn(SpawnContext):
    """Fork is unsafe once torch or a renderer has threads."""

    Process = _Worker


def spawn() -> SpawnContext:
    """How processes start: by spawn, and importing nothing from the working directory."""
    with _safe_path():
        resource_tracker.ensure_running()  # a process, too
    return _Spawn()


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

    @contextmanager
    def task(self, label: str, total: int, done: int = 0) -> Iterator[Advance]:
        """Show a bar in the parent."""
        self._tasks += 1
        key = (os.getpid(), threading.get_ident(), self._tasks)
        waiting, sent = 0, time.monotonic()

        def advance(steps: int) -> None:
            nonlocal waiting, sent
            waiting += steps
            if time.monotonic() - sent >= self.SEND_EVERY:
                self._queue.put(("advance", key, waiting))
                waiting, sent = 0, time.monotonic()

        self._queue.put(("open", key, (label, total, done)))
        try:
            yield advance
        finally:
            self._queue.put(("advance", key, waiting))
            self._queue.put(("close", key, None))

    def note(self, text: str) -> None:
        """Say one line in the parent."""
        self._queue.put(("note", None, text))


@contextmanager
def relayed(progress: Progress, *, wanted: bool = True) -> Iterator[Progress]:
    """Progress that can be sent to workers and ends up in `progress`; itself if not `wanted`."""
    if not wanted:
        yield progress
        return
    with spawn().Manager() as manager:
        queue = manager.Queue()
        listener = threading.Thread(target=_listen, args=(queue, progress), daemon=True)
        listener.start()
        try:
            yield Relay(queue)
        finally:
            queue.put(("end", None, None))
            listener.join()


def _listen(queue: _Queue, progress: Progress) -> None:
    """Show what workers send until they end; a note of several workers is shown once."""
    open_tasks: dict[Any, tuple[ExitStack, Advance]] = {}
    said = set()
    while True:
        what, key, value = queue.get()
        if what == "end":
            break
        if what == "note" and value not in said:
            said.add(value)
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
