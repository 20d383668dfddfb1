"""Owns the command line: options in, text, JSON and exit codes out.

Imports nothing heavy until a command runs, so that help is immediate. Knows
nothing of programs or bounds: it loads, plans, and prints what comes back.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TextIO

import click

from enumerate.cli_audit import audit
from enumerate.cli_exit import (
    BAD_INPUT,
    INFEASIBLE,
    INTERRUPTED,
    NOT_WRITTEN,
    PLANNED,
    STOPPED,
    Group,
    abandon,
    before_planning,
    fail,
)
from enumerate.cli_options import GAP, QUIET, SECONDS, WORKERS, one_word, settings
from enumerate.cli_output import (
    STDOUT,
    check_files,
    check_folder,
    say,
    write_all,
    write_text,
)
from enumerate.cli_studies import pareto, sweep
from enumerate.display import show_progress
from enumerate.table import paragraph

if TYPE_CHECKING:
    from enumerate.result import Result
    from relax.trip import Trip

__all__ = [
    "BAD_INPUT",
    "INFEASIBLE",
    "INTERRUPTED",
    "NOT_WRITTEN",
    "PLANNED",
    "STOPPED",
    "main",
    "show_versions",
]

DEPENDENCIES = (
    "numpy", "scipy", "clarabel", "osqp", "cvxpy", "matplotlib", "pydantic", "click", "tqdm",
    "casadi",
)  # fmt: skip


def show_versions(stream: TextIO | None = None) -> None:
    """Print the versions that a bug report needs.

    Parameters
    ----------
    stream : text stream, optional
        Standard output by default.

    Examples
    --------
    >>> show_versions()
    evrelax     ...
    python      ...
    """
    import platform
    from importlib.metadata import PackageNotFoundError, version

    def installed(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return "not installed"

    rows = {
        "evrelax": installed("evrelax"),
        "python": f"{platform.python_version()} ({platform.python_implementation()})",
        "platform": f"{platform.platform()}, {platform.machine()}",
        **{name: installed(name) for name in DEPENDENCIES},
    }
    for name, value in rows.items():
        print(f"{name:<12}{value}", file=stream or sys.stdout)


@click.group(
    cls=Group,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, wanted: _print_version(context, wanted),
    help="Show the version and exit.",
)
def main() -> None:
    """Plan the charging stops and the battery temperature of a long electric-car trip."""


def _print_version(context: click.Context, wanted: bool) -> None:
    if wanted and not context.resilient_parsing:
        from importlib.metadata import PackageNotFoundError, version

        try:
            click.echo(f"evrelax {version('evrelax')}")
        except PackageNotFoundError:
            click.echo("evrelax (not installed)")
        context.exit()


# ---------------------------------------------------------------------------- commands


@main.command()
@click.argument("trip")
@click.option(
    "--gap",
    metavar="NUMBER",
    callback=GAP,
    help="Relative gap to prove, e.g. 0.01; without it only the quick bounds are computed.",
)
@click.option(
    "--time-limit",
    metavar="SECONDS",
    default="60",
    show_default=True,
    callback=SECONDS,
    help="Return the best plan and bound known by then; 'inf' for no limit.",
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=settings,
    help="Replace a value of the trip, e.g. route.ambient_c=-10, vehicle.heat_pump_kw=3, "
    "charger.NAME.power_kw=50. May be repeated.",
)
@click.option(
    "--json",
    "json_file",
    metavar="FILE",
    help="Write the result as JSON; with '-', to standard output and nothing else there.",
)
@click.option(
    "--plot",
    "plot_folder",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Draw the plan into this folder, as PNG and SVG.",
)
@click.option(
    "--ledger",
    "ledger_file",
    metavar="FILE",
    help="Write the proofs of all bounds, for 'evrelax audit'.",
)
@click.option(
    "--certificate",
    is_flag=True,
    help="Print the convexity certificate of the plan's stops as well.",
)
@WORKERS
@click.option(
    "--solver",
    metavar="[clarabel|osqp]",
    default="clarabel",
    show_default=True,
    callback=one_word(["clarabel", "osqp"]),
    help="Solver of the quadratic programs.",
)
@click.option(
    "--all",
    "everything",
    is_flag=True,
    help="Plan every choice of stops, skip none by its bound; up to ten chargers.",
)
@QUIET
def plan(
    trip: str,
    gap: float | None,
    time_limit: float,
    overrides: dict[str, object],
    json_file: str | None,
    plot_folder: Path | None,
    ledger_file: str | None,
    certificate: bool,
    workers: int,
    solver: Literal["clarabel", "osqp"],
    everything: bool,
    quiet: bool,
) -> None:
    """Plan TRIP, the name of a shipped trip or a TOML file.

    Exit codes: 0 a plan was found; 1 it could not be written in full, or its proofs not; 2 bad
    input; 3 proved infeasible; 4 stopped without a plan; 130 Ctrl-C while it ends. The first Ctrl-C
    stops the search and prints what is known by then, a second one ends at once.
    """
    with before_planning():
        check_files({"--json": json_file, "--ledger": ledger_file}, trip)
        check_folder("--plot", plot_folder)
        loaded = _load(trip, overrides, everything)
    try:
        from enumerate.search import plan as plan_trip

        with show_progress(quiet) as report:
            result = plan_trip(
                loaded,
                gap=gap,
                time_limit_s=time_limit,
                workers=workers,
                solver=solver,
                prune=not everything,
                progress=report,
                keep_proofs=ledger_file is not None,
            )
    except KeyboardInterrupt:
        abandon("interrupted before a plan could be driven", STOPPED)
    code = _write(result, loaded, json_file, plot_folder, ledger_file, certificate)
    if ledger_file is not None and not result.proofs:
        fail("nothing is proved yet: no ledger was written", code or NOT_WRITTEN)
    sys.exit(code)


@main.command()
def trips() -> None:
    """List the trips, vehicles and routes that come with the package."""
    for kind, names in _shipped().items():
        say(kind)
        for name, text in names.items():
            say(paragraph(f"  {name}", text, 28))


@main.command()
@click.argument("what", metavar="[trip|vehicle]", callback=one_word(["trip", "vehicle"]))
def schema(what: str) -> None:
    """Print the JSON Schema of a trip file or a vehicle file."""
    import json

    from relax.load import trip_schema, vehicle_schema

    say(json.dumps(trip_schema() if what == "trip" else vehicle_schema(), indent=2))


@main.command()
def versions() -> None:
    """Print the versions that a bug report needs."""
    show_versions()


main.add_command(audit)
main.add_command(pareto)
main.add_command(sweep)


# ---------------------------------------------------------------------------- input


def _shipped() -> dict[str, dict[str, str]]:
    """Return a line about everything shipped, by kind and name."""
    import tomllib
    from importlib.resources import files

    from relax.load import shipped_routes, shipped_trips, shipped_vehicles

    def text(kind: str, file: str) -> str:
        return (files("relax") / "data" / kind / file).read_text(encoding="utf-8")

    def first_comment(name: str, content: str) -> str:
        return content.split("\n", 1)[0].lstrip("# ").removeprefix(f"{name}: ").strip()

    return {
        "trips": {
            name: str(tomllib.loads(text("trips", f"{name}.toml")).get("description", ""))
            for name in shipped_trips()
        },
        "vehicles": {
            name: first_comment(name, text("vehicles", f"{name}.toml"))
            for name in shipped_vehicles()
        },
        "routes": {
            name: first_comment(name, text("routes", f"{name}.csv")) for name in shipped_routes()
        },
    }


def _load(trip: str, overrides: dict[str, object], everything: bool = False) -> Trip:
    """Load a trip and refuse what the search would refuse."""
    from enumerate.search import MAX_CHARGERS, MAX_PLANNED
    from relax.errors import InputError
    from relax.load import load_trip

    loaded = load_trip(trip, overrides)
    number = len(loaded.chargers)
    if number > MAX_CHARGERS:
        raise InputError(trip, "charger", f"{number} of them", f"at most {MAX_CHARGERS}")
    if everything and number > MAX_PLANNED:
        allowed = f"at most {MAX_PLANNED} with --all"
        raise InputError(trip, "charger", f"{number} of them", allowed)
    return loaded


# ---------------------------------------------------------------------------- output


def _write(
    result: Result,
    trip: Trip,
    json_file: str | None,
    plot_folder: Path | None,
    ledger_file: str | None,
    certificate: bool,
) -> int:
    """Print and write a result; return the exit code."""
    import json

    from enumerate.evidence_file import save_proofs
    from enumerate.result import Status
    from enumerate.show import format_result

    pure = json_file == STDOUT
    outputs = [] if pure else [("standard output", lambda: say(format_result(result, trip)))]
    if json_file is not None:
        text = json.dumps(result.to_dict(), allow_nan=False)
        name = "standard output" if pure else f"--json {json_file}"
        outputs.append((name, lambda: write_text(json_file, text)))
    if pure and result.plan is None and result.diagnosis is not None:
        why = f"evrelax: {result.trip}: no plan: {result.diagnosis.reason}"
        outputs.append(("standard error", lambda: say(why, err=True)))
    if certificate and result.instance is not None:
        outputs.append(("the certificate", lambda: say(f"\n{result.certificate}", err=pure)))
    if plot_folder is not None:
        outputs.append((f"--plot {plot_folder}", lambda: _plot(result, trip, plot_folder)))
    if ledger_file is not None and result.proofs:
        name = f"--ledger {ledger_file}"
        outputs.append((name, lambda: save_proofs(ledger_file, trip, result)))
    write_all(outputs)
    if result.plan is not None:
        return PLANNED
    return INFEASIBLE if result.status is Status.INFEASIBLE else STOPPED


def _plot(result: Result, trip: Trip, folder: Path) -> None:
    if result.plan is not None:
        from relax.plot import save_plots

        save_plots(result.plan, trip, folder)


if __name__ == "__main__":
    main()
