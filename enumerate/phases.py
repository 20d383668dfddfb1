"""Owns the order of a long search: phase after phase, until done or interrupted, with their times.

Knows nothing of what the phases do.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol

__all__ = ["REPLAY", "Interruptible", "run_phases"]

REPLAY = "replay"
"""The phase that runs whatever happened before: it judges what has been found."""


class Interruptible(Protocol):
    """A search that can be stopped."""

    interrupted: str
    """Why it was stopped; empty if it was not."""

    def drive(self) -> None:
        """Judge what has been found."""


def run_phases(
    search: Interruptible, phases: Sequence[tuple[str, Callable[[], None]]], begin: float
) -> dict[str, float]:
    """Run phases one after the other; Ctrl-C or a stop of the search skips all but the replay.

    Parameters
    ----------
    search : Interruptible
        What the phases work on.
    phases : sequence of (str, callable)
        Name and work of each.
    begin : float
        ``time.perf_counter()`` at which the first began [s].

    Returns
    -------
    dict
        Time of each phase that ran [s].

    Examples
    --------
    >>> class Nothing:
    ...     interrupted = ""
    ...     def drive(self) -> None: ...
    >>> list(run_phases(Nothing(), [("relax", lambda: None)], time.perf_counter()))
    ['relax']
    """
    timings: dict[str, float] = {}
    for name, phase in phases:
        if search.interrupted and name != REPLAY:
            continue
        try:
            phase()
        except KeyboardInterrupt:
            search.interrupted = "interrupted"
            if name == REPLAY:  # what was found is worth more than the moment
                search.drive()
        timings[name] = time.perf_counter() - begin - sum(timings.values())
    return timings
