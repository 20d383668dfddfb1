"""Owns the process that measurements run in: kept alive between them, killed at a time limit.

A native solver that crashes or hangs costs its own row and nothing else. The process is
single-threaded, on one core, and its standard output is closed, for solvers print there. Knows
nothing of what is measured.
"""

from __future__ import annotations

import importlib
import os
import signal
import traceback
from multiprocessing import get_context
from typing import Any

from benchmarks.machine import make_single_threaded

__all__ = ["Worker", "WorkerError"]


class WorkerError(Exception):
    """A task gave no result: an error in it, a crash, or the time limit."""


def _serve(pipe: Any) -> None:
    """Run tasks until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, who then kills us
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    while True:
        try:
            module, function, arguments = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send((True, getattr(importlib.import_module(module), function)(*arguments)))
        except Exception as error:  # whatever it is, it belongs into the row
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{os.path.basename(last.filename)}:{last.lineno}"
            pipe.send((False, f"{type(error).__name__} at {where}: {error}"))


class Worker:
    """One process, started when it is needed.

    Examples
    --------
    >>> with Worker() as worker:
    ...     worker.run("math", "sqrt", (9.0,), 60.0)
    3.0
    """

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._pipe.close()
            self._process.kill()
            self._process.join()
            self._process = self._pipe = None

    def _start(self) -> None:
        make_single_threaded()  # inherited: the libraries read it when the process imports them
        self._pipe, end = self._context.Pipe()
        self._process = self._context.Process(target=_serve, args=(end,), daemon=True)
        self._process.start()
        end.close()

    def run(
        self, module: str, function: str, arguments: tuple[Any, ...], time_limit_s: float
    ) -> Any:
        """Return what a function returns in the process.

        Parameters
        ----------
        module, function : str
            Imported there.
        arguments : tuple
            Picklable.
        time_limit_s : float
            The process is killed when it takes longer [s].

        Raises
        ------
        WorkerError
            Without a result; the next call starts a new process if this one is lost.
        """
        if self._process is None:
            self._start()
        self._pipe.send((module, function, arguments))
        try:
            if not self._pipe.poll(time_limit_s):
                self.close()
                raise WorkerError(f"stopped after {time_limit_s:.0f} s")
            good, value = self._pipe.recv()
        except EOFError:
            self._process.join()
            code = self._process.exitcode
            self.close()
            raise WorkerError(f"the process died, exit code {code}") from None
        except KeyboardInterrupt:
            self.close()
            raise
        if not good:
            raise WorkerError(value)
        return value
