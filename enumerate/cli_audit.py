"""Owns the command that audits a file of proofs: options in, text and exit code out.

``cli`` registers it; what it needs is imported when the command runs, like everything heavy.
Loads neither the search nor a solver.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["audit"]

HOLDS, FAILS = 0, 1
"""Exit codes beside those of bad input and of an interruption."""


def _setting(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> dict[str, object]:
    from enumerate.cli import _setting as read

    return read(context, parameter, values)


@click.command()
@click.argument("file")
@click.argument("trip")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_setting,
    help="Replace a value of the trip, as when it was planned. May be repeated.",
)
@click.option("--quiet", "-q", is_flag=True, help="No progress on standard error.")
def audit(file: str, trip: str, overrides: dict[str, object], quiet: bool) -> None:
    """Check FILE, written by 'plan --ledger', against TRIP: every bound, without a solver.

    Exit codes: 0 every claim holds; 1 one does not, and is named; 2 bad input; 4 interrupted.
    """
    from enumerate.cli import STOPPED, _echo, _fail, _input_errors

    with _input_errors():
        from enumerate.audit import audit as check
        from relax.load import load_trip

        loaded = load_trip(trip, overrides)
        try:
            with _progress(quiet) as report:
                found = check(file, loaded, report)
        except KeyboardInterrupt:
            _fail("interrupted: nothing is confirmed", STOPPED)
    _echo(str(found))
    sys.exit(HOLDS if found.holds else FAILS)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Yield what the audit calls after every step; away from a terminal it speaks late."""
    if quiet:
        yield None
        return
    from tqdm import tqdm

    from enumerate.cli import QUIET_S

    terminal = sys.stderr.isatty()
    bar: Any = tqdm(
        desc="audit",
        unit="step",
        file=sys.stderr,
        leave=False,
        delay=0.5 if terminal else QUIET_S,
        mininterval=0.1 if terminal else QUIET_S,
    )

    def tell(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)

    with bar:
        yield tell
