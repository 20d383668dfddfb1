"""Owns the commands that run many plans: ``pareto`` and ``sweep``.

Options in, tables and JSON out. ``cli`` registers them; what they need is
imported when a command runs, like everything heavy.
"""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from enumerate.front import Front
    from enumerate.sweep import SweepRow

__all__ = ["pareto", "sweep"]

MOST_VALUES = 100_000
"""Values of one range beyond which its step is a slip."""


def _gap(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    from enumerate.cli import _gap as check

    return check(context, parameter, value)


def _setting(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> dict[str, object]:
    from enumerate.cli import _setting as read

    return read(context, parameter, values)


TRIP_SETTINGS = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_setting,
    help="Replace a value of the trip. May be repeated.",
)
QUIET = click.option("--quiet", "-q", is_flag=True, help="No progress on standard error.")


@click.command()
@click.argument("trip")
@click.option("--points", type=click.IntRange(min=2), default=12, show_default=True)
@click.option(
    "--measure",
    type=click.Choice(["energy", "cost"]),
    default="energy",
    show_default=True,
    help="Energy from the chargers, or what the trip costs without the value of time.",
)
@click.option(
    "--gap",
    type=float,
    default=0.01,
    show_default=True,
    callback=_gap,
    help="Relative gap to prove of every point.",
)
@click.option("--no-proof", is_flag=True, help="Leave the bounds at the quick ones.")
@click.option("--time-limit", type=float, default=float("inf"), metavar="SECONDS")
@click.option(
    "--latest-min", type=float, default=None, metavar="MINUTES", help="Longest time of interest."
)
@click.option("--json", "json_file", metavar="FILE", help="Write the front as JSON; '-': print it.")
@TRIP_SETTINGS
@QUIET
def pareto(
    trip: str,
    points: int,
    measure: Any,
    gap: float,
    no_proof: bool,
    time_limit: float,
    latest_min: float | None,
    json_file: str | None,
    overrides: dict[str, object],
    quiet: bool,
) -> None:
    """Trade energy or cost of TRIP against its charging and detour time.

    Exit codes: 0 the front was found; 2 bad input; 4 no plan was found.
    """
    from enumerate.cli import (
        PLANNED,
        STDOUT,
        STOPPED,
        _check_outputs,
        _echo,
        _input_errors,
        _load,
        _progress,
    )

    with _input_errors():
        _check_outputs(json_file, None)
        loaded = _load(trip, overrides)
    if latest_min is not None and not latest_min > 0.0:
        raise click.BadParameter("a number of minutes above 0", param_hint="--latest-min")
    from enumerate.pareto import pareto as find_front

    with _progress(quiet) as report:
        front = find_front(
            loaded,
            points=points,
            measure=measure,
            gap=None if no_proof else gap,
            latest_h=None if latest_min is None else latest_min / 60.0,
            time_limit_s=time_limit,
            progress=report,
        )
    if json_file is not None:
        _write(json_file, json.dumps(front.to_dict(), allow_nan=False))
    if json_file != STDOUT:
        _echo(_front_text(front))
    sys.exit(PLANNED if front.points else STOPPED)


def _front_text(front: Front) -> str:
    """Return a front as a table for people."""
    from enumerate.table import number, percent, table

    if not front.points:
        return f"{front.trip}: no plan found" + (
            f" ({front.interrupted})" * bool(front.interrupted)
        )
    head = ["time min", front.unit, "bound", "gap %", "front gap %", "stops"]
    rows = [
        [
            number(60.0 * p.time_h, 2),
            number(p.value, 2),
            number(p.lower_bound, 2),
            percent(p.gap),
            percent(p.front_gap),
            " + ".join(p.stops) or "none",
        ]
        for p in front.points
    ]
    notes = [
        "",
        "time: charging and detours. bound: no plan within this time undercuts it. front gap: no",
        "plan is better by more than this share in both time and " + front.measure + ".",
    ]
    if front.interrupted:
        notes.append(f"Not complete: {front.interrupted}.")
    return "\n".join(
        [
            f"{front.trip}: {front.measure} against time",
            "",
            table(head, rows, words_last=True),
            *notes,
        ]
    )


@click.command()
@click.argument("trip")
@click.option(
    "--over",
    "over",
    multiple=True,
    required=True,
    metavar="KEY=VALUES",
    help="Values to combine: a list '0,1,3' or a range 'first:last:step'. May be repeated.",
)
@click.option(
    "--file",
    "file",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="JSON lines; rows found there are not computed again.",
)
@click.option("--gap", type=float, default=None, callback=_gap, help="Relative gap to prove.")
@click.option("--time-limit", type=float, default=None, metavar="SECONDS", help="Of every plan.")
@click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes."
)
@TRIP_SETTINGS
@QUIET
def sweep(
    trip: str,
    over: tuple[str, ...],
    file: Path,
    gap: float | None,
    time_limit: float | None,
    workers: int,
    overrides: dict[str, object],
    quiet: bool,
) -> None:
    """Plan every combination of some values of TRIP and save each as it comes.

    Ctrl-C keeps what is done; the same command goes on. Exit codes: 0 all done; 2 bad
    input; 4 some are missing.
    """
    from enumerate.cli import STOPPED, _check_outputs, _fail, _input_errors
    from enumerate.sweep import sweep as run

    values = dict(_values(text) for text in over)
    with _input_errors():
        _check_outputs(str(file), None)
        with _rows(quiet) as report:
            found = run(
                trip,
                values,
                gap=gap,
                overrides=overrides,
                time_limit_s=time_limit,
                workers=workers,
                file=file,
                progress=report,
            )
    failed = sum(1 for row in found.rows if row.error)
    click.echo(f"{len(found.rows)} rows in {file}, {failed} of them no valid trip")
    if found.missing:
        _fail(f"{len(found.missing)} missing: {found.interrupted}", STOPPED)


def _values(text: str) -> tuple[str, list[Any]]:
    """Return key and values of ``key=1,2,3`` or ``key=first:last:step``."""
    import tomllib

    key, equals, listed = text.partition("=")
    try:
        if not (equals and key.strip() and listed.strip()):
            raise ValueError
        if listed.count(":") == 2:
            return key.strip(), _range(*(float(x) for x in listed.split(":")))
        found: list[Any] = []
        for entry in listed.split(","):
            try:
                found.append(tomllib.loads(f"value = {entry}")["value"])
            except tomllib.TOMLDecodeError:
                found.append(entry.strip())
        return key.strip(), found
    except (ValueError, ZeroDivisionError):
        allowed = f"{text!r}; allowed: key=a,b,c or key=first:last:step"
        raise click.BadParameter(allowed, param_hint="--over") from None


def _range(first: float, last: float, step: float) -> list[Any]:
    """Return first, first + step ... up to last, as whole numbers where they all are."""
    if not 0.0 <= (last - first) / step < MOST_VALUES:
        raise ValueError
    count = int((last - first) / step + 1e-9) + 1
    values = [first + step * k for k in range(count)]
    return [int(v) for v in values] if first.is_integer() and step.is_integer() else values


@contextmanager
def _rows(quiet: bool) -> Iterator[Callable[[int, int, SweepRow], None] | None]:
    """Yield what the sweep calls after every row."""
    if quiet:
        yield None
        return
    from enumerate.cli import _bar
    from enumerate.explore import Progress

    bars: list[Any] = []

    def tell(done: int, total: int, row: SweepRow) -> None:
        if not bars:
            start = Progress("sweep", 0, total, float("inf"), float("-inf"))
            bars.append(_bar(start, sys.stderr.isatty()))
        bars[0].update(done - bars[0].n)

    try:
        yield tell
    finally:
        for bar in bars:
            bar.close()


def _write(json_file: str, text: str) -> None:
    from enumerate.cli import STDOUT

    if json_file == STDOUT:
        click.echo(text)
    else:
        Path(json_file).write_text(text + "\n", encoding="utf-8")
