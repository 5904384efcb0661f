"""What an engine offers to the stages: tasks in worker processes, and progress from there."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

from elast_cli.progress import Progress

T = TypeVar("T")
R = TypeVar("R")
K = TypeVar("K", bound=Hashable)


class Engine(Protocol):
    """Where the tasks of a stage run. Results do not depend on it.

    Tasks are functions of a module, and items can be pickled. If a worker is lost, another one
    repeats its item, so tasks must be repeatable. An error of a task is raised by the iterator
    that waits for its result, and ends the other tasks.
    """

    @property
    def workers(self) -> int:
        """Most tasks at a time."""
        ...

    def each(self, task: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """`task(item)` of every item, as they complete."""
        ...

    def graph(
        self,
        needs: Mapping[K, Collection[K]],
        item: Callable[[K], T],
        task: Callable[[T], R],
    ) -> Iterator[tuple[K, R]]:
        """`task(item(key))` of every key, as they complete; a key's turn comes after all its needs.

        The caller has the results of a key's needs when `item` is called for it.

        Args:
            needs: the keys in order, and what each waits for; needs that are no keys count as done.
            item: what a task is given, asked for when its turn comes.
            task: sent to workers, with its item.

        Raises:
            ValueError: keys wait for one another.
        """
        ...

    def relayed(self, progress: Progress, tasks: int) -> AbstractContextManager[Progress]:
        """Progress that `tasks` tasks can be sent with their items, and that ends up here."""
        ...
