"""Owns running tasks in order, here or on an executor. Knows nothing of what the tasks do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from typing import TypeVar

__all__ = ["run_in_order"]

T = TypeVar("T")
R = TypeVar("R")


def run_in_order(
    executor: Executor | None, task: Callable[[T], R], items: Iterable[T]
) -> Iterator[R]:
    """Yield the results of a task in the order of its items.

    Parameters
    ----------
    executor : Executor or None
        Any ``concurrent.futures.Executor``; None runs here, one after the other.
    task : callable
        Picklable if the executor needs it.
    items : iterable
        Arguments.

    Notes
    -----
    When the consumer stops early (an error, Ctrl-C), tasks not yet begun are cancelled.

    Examples
    --------
    >>> list(run_in_order(None, abs, [-1, 2]))
    [1, 2]
    """
    if executor is None:
        yield from map(task, items)
        return
    futures = [executor.submit(task, item) for item in items]
    try:
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
