"""Owns silence: solvers in compiled code that print to the process's standard streams.

Some print through Python's ``sys.stdout``, some past it, so both that and the
file descriptor are turned away for a while. Knows no solver.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress

__all__ = ["quiet"]

STDOUT, STDERR = 1, 2
"""File descriptors."""


def _flush() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)  # what C code has buffered belongs where it was printed


@contextmanager
def quiet(errors: bool = False) -> Iterator[None]:
    """Discard everything that is printed to the standard output, by compiled code too.

    Parameters
    ----------
    errors : bool
        Whether the standard error is discarded as well.

    Examples
    --------
    >>> import os
    >>> with quiet():
    ...     _ = os.write(1, b"nobody reads this")
    ...     print("nor this")
    """
    _flush()
    kept = {number: os.dup(number) for number in ((STDOUT, STDERR) if errors else (STDOUT,))}
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for number in kept:
            os.dup2(nowhere.fileno(), number)
        try:
            with redirect_stdout(nowhere):
                yield
        finally:
            _flush()
            for number, copy in kept.items():
                os.dup2(copy, number)
                os.close(copy)
