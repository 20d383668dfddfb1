"""Owns the command that audits a file of proofs: options in, text and exit code out.

``cli`` registers it; what it needs is imported when the command runs, like everything heavy.
Loads neither the search nor a solver.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from enumerate.cli_exit import BAD_INPUT, STOPPED, Command, before_planning, fail
from enumerate.cli_options import QUIET, settings
from enumerate.cli_output import say, write_all
from enumerate.display import open_bar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["audit"]

HOLDS, FAILS = 0, 1
"""Exit codes beside those of bad input and of an interruption."""
OTHER_TRIP = "proofs of the trip"
"""What ``enumerate.audit`` calls the field that is wrong where a file is of another trip."""


@click.command(cls=Command)
@click.argument("file")
@click.argument("trip")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=settings,
    help="Replace a value of the trip, as when it was planned. May be repeated.",
)
@QUIET
def audit(file: str, trip: str, overrides: dict[str, object], quiet: bool) -> None:
    """Check FILE, written by 'plan --ledger', against TRIP: every bound, without a solver.

    Exit codes: 0 every claim holds; 1 one does not, and is named; 2 bad input; 4 interrupted:
    nothing is confirmed. 1 also if the answer cannot be written.
    """
    from relax.errors import InputError

    with before_planning():
        from enumerate.audit import audit as check
        from relax.load import load_trip

        loaded = load_trip(trip, overrides)
    try:
        with _progress(quiet) as report:
            found = check(file, loaded, report)
    except KeyboardInterrupt:
        fail("interrupted: nothing is confirmed", STOPPED)
    except InputError as error:
        if error.field == OTHER_TRIP and error.value == loaded.name:
            fail(
                f"{file}: proofs of the trip {loaded.name!r} with other numbers; "
                "allowed: proofs with the same numbers (--set as when planning)",
                BAD_INPUT,
            )
        raise
    write_all([("standard output", lambda: say(str(found)))])
    sys.exit(HOLDS if found.holds else FAILS)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Yield what the audit calls after every step; away from a terminal it speaks late."""
    if quiet:
        yield None
        return
    bar: Any = open_bar("audit", None, "step")

    def tell(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)

    with bar:
        yield tell
