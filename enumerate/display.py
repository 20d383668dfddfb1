"""Owns how progress looks on standard error: one line for a search, a bar where the end is known.

A search does not know how many parts a proof will need, so it has no bar and no time left:
its line says what is done, what is open, and how near the bound is to the best plan.
Knows nothing of plans and imports nothing heavy before something is to be shown.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, Any

from enumerate.gap import relative_gap
from enumerate.table import WIDTH, number, percent

if TYPE_CHECKING:
    from enumerate.explore import Progress

__all__ = ["QUIET_S", "open_bar", "progress_line", "show_progress"]

QUIET_S = 10.0
"""Away from a terminal, progress is told only this long after the start, and this often [s]."""
DELAY_S, EVERY_S = 0.5, 0.1
"""The same at a terminal."""
CLOCK = 7
"""Room for the time that passed, ``, 59:59`` [characters]."""


def progress_line(progress: Progress) -> str:
    """Return where a search stands, in a line that fits a terminal with the time behind it.

    Parameters
    ----------
    progress : Progress
        What a search reports.

    Examples
    --------
    >>> from math import inf
    >>> from enumerate.explore import Progress
    >>> progress_line(Progress("prove", 90, 120, 200.0, 198.0))
    'prove: 90 done, 30 open, best 200.00, bound 198.00, gap 1.00 %'
    >>> progress_line(Progress("relax", 3, 8, inf, -inf))
    'relax: 3 done, 5 open'
    """
    parts = [f"{progress.phase}: {progress.done} done"]
    room = WIDTH - 1 - CLOCK
    if progress.total > progress.done:
        parts.append(f"{progress.total - progress.done} open")
    gap = relative_gap(progress.cost, progress.lower_bound)
    if isfinite(progress.cost):
        parts.append(f"best {number(progress.cost, 2)}")
    if isfinite(progress.lower_bound):
        parts.append(f"bound {number(progress.lower_bound, 2)}")
    if isfinite(gap):
        parts.append(f"gap {percent(gap, 2)} %")
    while len(", ".join(parts)) > room and len(parts) > 2:
        del parts[1]  # what is open says least, the gap says most
    return ", ".join(parts)[:room]


@contextmanager
def show_progress(quiet: bool) -> Iterator[Callable[[Progress], None] | None]:
    """Yield what a search calls to tell how far it is; None if nobody wants to know.

    Examples
    --------
    >>> with show_progress(quiet=True) as report:
    ...     report is None
    True
    """
    if quiet:
        yield None
        return
    from tqdm import tqdm

    # one line for all phases: they come again and again in a proof
    with tqdm(bar_format="{desc}, {elapsed}", **_manner()) as line:

        def tell(progress: Progress) -> None:
            room = (line.ncols or WIDTH) - CLOCK  # a terminal may be narrow
            text = progress_line(progress)[:room]
            line.set_description_str(text, refresh=False)
            line.update()

        yield tell


def open_bar(phase: str, total: int | None, unit: str) -> Any:
    """Return a bar for work whose end is known; ``total`` may be set later.

    Parameters
    ----------
    phase : str
        What is being done.
    total : int or None
        How much there is to do.
    unit : str
        Of what.

    Examples
    --------
    >>> with open_bar("audit", 8, "step") as bar:
    ...     bar.total
    8
    """
    from tqdm import tqdm

    return tqdm(total=total, desc=phase, unit=unit, **_manner())


def _manner() -> dict[str, Any]:
    """Return how to speak: no wider than a page, and away from a terminal late and seldom."""
    terminal = sys.stderr.isatty()
    wide = shutil.get_terminal_size((WIDTH, 24)).columns if terminal else WIDTH
    return {
        "file": sys.stderr,
        "leave": False,
        "ncols": min(wide, WIDTH) - 1,
        "delay": DELAY_S if terminal else QUIET_S,
        "mininterval": EVERY_S if terminal else QUIET_S,
        "miniters": 1,
    }
