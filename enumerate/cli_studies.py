"""Owns the commands that run many plans: ``pareto`` and ``sweep``.

Options in, tables and JSON out. ``cli`` registers them; what they need is
imported when a command runs, like everything heavy.
"""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from enumerate.cli_exit import (
    INFEASIBLE,
    PLANNED,
    STOPPED,
    Command,
    before_planning,
    fail,
)
from enumerate.cli_options import (
    GAP,
    MINUTES,
    QUIET,
    SECONDS,
    WORKERS,
    one_word,
    read_values,
    settings,
    whole,
)
from enumerate.cli_output import (
    STDOUT,
    check_files,
    say,
    write_all,
    write_text,
)
from enumerate.display import open_bar, show_progress

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from enumerate.result import Result
    from enumerate.sweep import Sweep, SweepRow
    from relax.trip import Trip

__all__ = ["pareto", "sweep"]

MOST_SHOWN = 40
"""Rows of a sweep that are printed; all of them are in its file."""
STOPPED_ROW = "stopped without a plan"


TRIP_SETTINGS = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=settings,
    help="Replace a value of the trip. May be repeated.",
)


@click.command(cls=Command)
@click.argument("trip")
@click.option("--points", metavar="NUMBER", default="12", show_default=True, callback=whole(2))
@click.option(
    "--measure",
    metavar="[energy|cost]",
    default="energy",
    show_default=True,
    callback=one_word(["energy", "cost"]),
    help="Energy from the chargers, or what the trip costs without the value of time.",
)
@click.option(
    "--gap",
    metavar="NUMBER",
    default="0.01",
    show_default=True,
    callback=GAP,
    help="Relative gap to prove of every point.",
)
@click.option("--no-proof", is_flag=True, help="Leave the bounds at the quick ones.")
@click.option(
    "--time-limit", default="inf", metavar="SECONDS", callback=SECONDS, help="Of the whole front."
)
@click.option("--latest-min", metavar="MINUTES", callback=MINUTES, help="Longest time of interest.")
@click.option("--json", "json_file", metavar="FILE", help="Write the front as JSON; '-': print it.")
@WORKERS
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
    workers: int,
    overrides: dict[str, object],
    quiet: bool,
) -> None:
    """Trade energy or cost of TRIP against its charging and detour time.

    Exit codes: 0 the front was found; 1 it could not be written; 2 bad input; 3 proved
    infeasible, with the reason; 4 stopped without a plan.
    """
    from enumerate.cli import _load

    with before_planning():
        check_files({"--json": json_file}, trip)
        loaded = _load(trip, overrides)
        from enumerate.pareto import MOST_CHARGERS
        from enumerate.pareto import pareto as find_front
        from enumerate.show_front import format_front
        from relax.errors import InputError

        if (number := len(loaded.chargers)) > MOST_CHARGERS:
            raise InputError(trip, "charger", f"{number} of them", f"at most {MOST_CHARGERS}")

    latest_h = None if latest_min is None else latest_min / 60.0
    with show_progress(quiet) as report:
        front = find_front(
            loaded,
            points=points,
            measure=measure,
            gap=None if no_proof else gap,
            latest_h=latest_h,
            time_limit_s=time_limit,
            workers=workers,
            progress=report,
        )
    none = None if front.points or front.interrupted else _without_front(loaded, latest_h)
    outputs = []
    if json_file is not None:
        text = json.dumps(front.to_dict(), allow_nan=False)
        outputs.append((f"--json {json_file}", lambda: write_text(json_file, text)))
    pure = json_file == STDOUT
    told = format_front(front) if none is None else _none_text(none, loaded, pure)
    if not (pure and front.points):
        outputs.append(("standard output", lambda: say(told, err=pure)))
    write_all(outputs)
    sys.exit(PLANNED if front.points else STOPPED if none is None else INFEASIBLE)


def _without_front(trip: Trip, latest_h: float | None) -> Result | None:
    """Return the proof that a trip without a front has no plan; None if it is not proved."""
    from enumerate.result import Status
    from enumerate.search import plan

    if latest_h is not None:
        trip = replace(trip, stop_time_h=min(trip.stop_time_h, latest_h))
    result = plan(trip)
    return result if result.status is Status.INFEASIBLE else None


def _none_text(result: Result, trip: Trip, short: bool) -> str:
    from enumerate.show import format_result

    if short and result.diagnosis is not None:
        return f"evrelax: {trip.name}: no plan: {result.diagnosis.reason}"
    return format_result(result, trip)


@click.command(cls=Command)
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
    type=click.Path(path_type=Path),
    required=True,
    help="JSON lines; rows found there are not computed again. Any other file is refused.",
)
@click.option("--gap", metavar="NUMBER", callback=GAP, help="Relative gap to prove.")
@click.option("--time-limit", metavar="SECONDS", callback=SECONDS, help="Of every plan.")
@click.option(
    "--workers",
    metavar="NUMBER",
    default="1",
    show_default=True,
    callback=whole(1),
    help="Processes.",
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

    Ctrl-C keeps what is done; the same command goes on. Exit codes: 0 all done, of which some may
    be proved infeasible or no valid trip: the table says which and why; 1 a row could not be
    written; 2 bad input, such as a key that does not exist or values of which none is allowed; 4
    some are missing.
    """
    values = read_values(over)
    computed: list[SweepRow] = []
    with before_planning():
        check_files({"--file": str(file)}, trip)
        from enumerate.sweep import sweep as run

        with _rows(quiet) as report:

            def count(done: int, total: int, row: SweepRow) -> None:
                computed.append(row)
                if report is not None:
                    report(done, total, row)

            found = run(
                trip,
                values,
                gap=gap,
                overrides=overrides,
                time_limit_s=time_limit,
                workers=workers,
                file=file,
                progress=count,
            )
    text = _sweep_text(found, list(values), file, len(computed))
    write_all([("standard output", lambda: say(text))])
    if found.missing:
        fail(f"{len(found.missing)} missing: {found.interrupted}", STOPPED)


def _sweep_text(found: Sweep, keys: Sequence[str], file: Path, computed: int) -> str:
    """Return a sweep as a table for people: what was varied, what came out, how many of each."""
    from enumerate.table import number, percent, table

    if not found.rows:
        return f"no rows in {file}"
    currency = next((r.result["currency"] for r in found.rows if r.result is not None), "")
    head = [*(key.replace(".", ".\n") for key in keys), f"cost\n{currency}", "bound", "gap\n%"]
    rows = []
    for row in found.rows[:MOST_SHOWN]:
        result = row.result or {}
        values = [str(row.variant[key]) for key in keys]
        sums = [number(result.get("cost"), 2), number(result.get("lower_bound"), 2)]
        rows.append([*values, *sums, percent(result.get("gap"), 2), _outcome(row)])
    counts = dict.fromkeys(("planned", "infeasible", STOPPED_ROW, "invalid"), 0)
    for row in found.rows:
        counts[_kind(row)] += 1
    said = ", ".join(f"{n} {kind}" for kind, n in counts.items() if n or kind != STOPPED_ROW)
    lines = [table([*head, "stops"], rows, words_last=True)]
    if len(found.rows) > MOST_SHOWN:
        lines.append(f"and {len(found.rows) - MOST_SHOWN} more")
    size = len(found.rows)
    plural = "" if size == 1 else "s"
    lines += ["", f"{size} row{plural} in {file} ({said}; {computed} computed anew)"]
    return "\n".join(lines)


def _kind(row: SweepRow) -> str:
    """Return how a row ended, in a word."""
    if row.result is None:
        return "invalid"
    if row.result["plan"] is not None:
        return "planned"
    return "infeasible" if row.result["status"] == "infeasible" else STOPPED_ROW


def _outcome(row: SweepRow) -> str:
    """Return the stops of a row's plan, or why it has none."""
    result = row.result
    if result is None:
        return f"invalid: {row.error}"
    if result["plan"] is not None:
        return " + ".join(stop["charger"] for stop in result["plan"]["stops"]) or "none"
    diagnosis = result["diagnosis"]
    why = result["interrupted"] if diagnosis is None else diagnosis["reason"]
    return _kind(row) + (f": {why}" if why else "")


@contextmanager
def _rows(quiet: bool) -> Iterator[Callable[[int, int, SweepRow], None] | None]:
    """Yield what the sweep calls after every row."""
    if quiet:
        yield None
        return
    bars: list[Any] = []

    def tell(done: int, total: int, _: SweepRow) -> None:
        if not bars:
            bars.append(open_bar("sweep", total, "plan"))
        bars[0].update(done - bars[0].n)

    try:
        yield tell
    finally:
        for bar in bars:
            bar.close()
