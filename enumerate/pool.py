"""Owns running tasks in order, here or by workers. Knows nothing of what the tasks do."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from functools import partial
from multiprocessing.synchronize import Event
from typing import Generic, TypeVar

__all__ = ["Pending", "open_pool", "run_in_order"]

T = TypeVar("T")
R = TypeVar("R")

_stop: Event | None = None
"""In a worker process: whether nobody waits for further results."""


@contextmanager
def open_pool(workers: int, executor: Executor | None = None) -> Iterator[Executor | None]:
    """Yield the executor given, or one with so many workers; None for one, who is the caller.

    Processes forked from this one on Linux: assembly and simulation hold the interpreter's
    lock, so threads gain little. Threads elsewhere, since a process that is not forked would
    load all packages anew, which takes longer than most plans; and where the system or a
    daemon's rules allow no processes.

    Parameters
    ----------
    workers : int
        At least 1.
    executor : Executor, optional
        One that somebody else opened and will close.

    Raises
    ------
    ValueError
        No worker.

    Examples
    --------
    >>> with open_pool(2) as pool:
    ...     list(run_in_order(pool, abs, [-1, 2]))
    [1, 2]
    """
    if not workers >= 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    if executor is not None or workers == 1:
        yield executor
        return
    stop = _make_stop()
    if stop is None:
        with ThreadPoolExecutor(workers) as threads:
            yield threads
        return
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(workers, context, _begin, (stop,)) as processes:
        try:
            yield processes
        finally:  # results that nobody took are not waited for
            stop.set()


def _make_stop() -> Event | None:
    """Return the event that tells forked workers to stop; None if there can be none."""
    if sys.platform != "linux" or multiprocessing.current_process().daemon:
        return None
    try:
        return multiprocessing.get_context("fork").Event()
    except (OSError, ImportError):  # no shared memory
        return None


def _begin(stop: Event) -> None:
    """Prepare a worker process: Ctrl-C is its parent's business, and it does not outlive it."""
    global _stop
    _stop = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run(task: Callable[[T], R], item: T) -> R:
    if _stop is not None and _stop.is_set():
        raise CancelledError
    return task(item)


class Pending(Generic[R]):
    """A task given to an executor; without one it runs here, when its result is asked for.

    Parameters
    ----------
    executor : Executor or None
        Any ``concurrent.futures.Executor``.
    task : callable
        Picklable if the executor needs it.
    item : any
        Its argument.

    Examples
    --------
    >>> Pending(None, abs, -1).result()
    1
    """

    def __init__(self, executor: Executor | None, task: Callable[[T], R], item: T) -> None:
        self._here: Callable[[], R] = partial(task, item)
        self._future: Future[R] | None = None
        if executor is not None:
            try:
                self._future = executor.submit(_run, task, item)
            except (BrokenExecutor, OSError):
                pass  # it lost a worker or got none: what is left is done here

    def result(self) -> R:
        """Return the result, as soon as there is one."""
        if self._future is not None:
            try:
                return self._future.result()
            except BrokenExecutor:
                pass
        return self._here()

    def cancel(self) -> None:
        """Do not begin the task if it has not been begun."""
        if self._future is not None:
            self._future.cancel()


def run_in_order(
    executor: Executor | None, task: Callable[[T], R], items: Iterable[T]
) -> Iterator[R]:
    """Yield the results of a task in the order of its items.

    Parameters
    ----------
    executor : Executor or None
        Any ``concurrent.futures.Executor``; None runs here, one after the other. So does a
        single item: nothing else could run meanwhile.
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
    items = list(items)
    pending = [Pending(executor if len(items) > 1 else None, task, item) for item in items]
    try:
        for each in pending:
            yield each.result()
    finally:
        for each in pending:
            each.cancel()
