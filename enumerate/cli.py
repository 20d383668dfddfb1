"""Owns the command line: options in, text, JSON and exit codes out.

Imports nothing heavy until a command runs, so that help is immediate. Knows
nothing of programs or bounds: it loads, plans, and prints what comes back.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TextIO

import click

from enumerate.cli_audit import audit
from enumerate.cli_studies import pareto, sweep

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from enumerate.explore import Progress
    from enumerate.result import Result
    from relax.errors import InputError
    from relax.trip import Trip

__all__ = ["main", "show_versions"]

PLANNED, NOT_WRITTEN, BAD_INPUT, INFEASIBLE, STOPPED = 0, 1, 2, 3, 4
"""Exit codes."""
QUIET_S = 10.0
"""Away from a terminal, progress is told only this long after the start, and this often [s]."""
STDOUT = "-"
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


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
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


def _gap(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    if value is not None and not 0.0 < value < float("inf"):
        raise click.BadParameter("a number above 0, e.g. 0.01 for 1 %", context, parameter)
    return value


def _seconds(context: click.Context, parameter: click.Parameter, value: float) -> float:
    if not value >= 0.0:
        raise click.BadParameter("a number of seconds of at least 0", context, parameter)
    return value


def _setting(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> dict[str, object]:
    """Return the overrides: TOML values, or strings where they are none."""
    import tomllib

    found: dict[str, object] = {}
    for text in values:
        key, equals, value = text.partition("=")
        if not (equals and key.strip()):
            raise click.BadParameter(f"{text!r}; allowed: key=value", context, parameter)
        try:
            document = tomllib.loads(f"value = {value}")
        except tomllib.TOMLDecodeError:
            document = {}
        found[key.strip()] = document["value"] if set(document) == {"value"} else value
    return found


@main.command()
@click.argument("trip")
@click.option(
    "--gap",
    type=float,
    default=None,
    callback=_gap,
    help="Relative gap to prove, e.g. 0.01; without it only the quick bounds are computed.",
)
@click.option(
    "--time-limit",
    type=float,
    metavar="SECONDS",
    default=60.0,
    show_default=True,
    callback=_seconds,
    help="Return the best plan and bound known by then; 'inf' for no limit.",
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_setting,
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
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Threads over the choices of stops.",
)
@click.option(
    "--solver",
    type=click.Choice(["clarabel", "osqp"]),
    default="clarabel",
    show_default=True,
    help="Solver of the quadratic programs.",
)
@click.option(
    "--all", "everything", is_flag=True, help="Plan every choice of stops, skip none by its bound."
)
@click.option("--quiet", "-q", is_flag=True, help="No progress on standard error.")
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

    Exit codes: 0 a plan was found; 1 it or its ledger could not be written; 2 bad input; 3 proved
    infeasible; 4 stopped without a plan. Ctrl-C stops the search and prints what is known by then.
    """
    with _input_errors():
        _check_outputs(json_file, plot_folder, ledger_file)
        loaded = _load(trip, overrides)
    try:
        from enumerate.search import plan as plan_trip

        with _progress(quiet) as report:
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
        _fail("interrupted before a plan could be driven", STOPPED)
    code = _tell(result, loaded, json_file, plot_folder)
    if certificate and result.certificate is not None:
        _echo(f"\n{result.certificate}", err=json_file == STDOUT)
    if ledger_file is not None:
        _save_ledger(ledger_file, loaded, result)
    sys.exit(code)


@main.command()
def trips() -> None:
    """List the trips, vehicles and routes that come with the package."""
    for kind, names in _shipped().items():
        click.echo(f"{kind}")
        for name, text in names.items():
            _echo(f"  {name:<26}{text}".rstrip())


@main.command()
@click.argument("what", type=click.Choice(["trip", "vehicle"]))
def schema(what: str) -> None:
    """Print the JSON Schema of a trip file or a vehicle file."""
    import json

    from relax.load import trip_schema, vehicle_schema

    click.echo(json.dumps(trip_schema() if what == "trip" else vehicle_schema(), indent=2))


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


def _load(trip: str, overrides: dict[str, object]) -> Trip:
    """Load a trip and refuse what the search would refuse."""
    from enumerate.search import MAX_CHARGERS
    from relax.errors import InputError
    from relax.load import load_trip

    loaded = load_trip(trip, overrides)
    number = len(loaded.chargers)
    if number > MAX_CHARGERS:
        raise InputError(trip, "charger", f"{number} of them", f"at most {MAX_CHARGERS}")
    return loaded


@contextmanager
def _input_errors() -> Iterator[None]:
    """Turn an input error into one line and its exit code."""
    from relax.errors import InputError

    try:
        yield
    except InputError as error:
        _fail(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        _fail("interrupted before planning", STOPPED)


def _fail(message: str, code: int) -> NoReturn:
    _echo("evrelax: " + " ".join(message.split("\n")), err=True)
    sys.exit(code)


def _check_outputs(
    json_file: str | None, plot_folder: Path | None, ledger_file: str | None = None
) -> None:
    """Refuse outputs that cannot be written before anything is computed."""
    import tempfile

    for option, file in (("--json", json_file), ("--ledger", ledger_file)):
        if file is None or (option == "--json" and file == STDOUT):
            continue
        path = Path(file)
        there = path.exists()
        try:
            if path.is_file() or path.is_dir() or not there:  # opening a pipe would wait
                with path.open("ab"):
                    pass
                if not there:
                    path.unlink()
        except OSError as error:
            raise _unwritable(option, file, error, "a file that can be written") from error
    if plot_folder is not None:
        try:
            plot_folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=plot_folder):
                pass
        except OSError as error:
            allowed = "a folder that can be written to"
            raise _unwritable("--plot", str(plot_folder), error, allowed) from error


def _unwritable(option: str, path: str, error: OSError, allowed: str) -> InputError:
    from relax.errors import InputError

    reason = (error.strerror or type(error).__name__).lower()
    return InputError("command line", option, path, f"{allowed} ({reason})")


# ---------------------------------------------------------------------------- output


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[Progress], None] | None]:
    """Yield what the search calls to tell how far it is."""
    if quiet:
        yield None
        return
    terminal = sys.stderr.isatty()
    with ExitStack() as stack:
        bars: dict[str, Any] = {}

        def tell(progress: Progress) -> None:
            if progress.phase not in bars:
                stack.close()  # ends the bar of the phase before
                bars[progress.phase] = stack.enter_context(_bar(progress, terminal))
            bar = bars[progress.phase]
            bar.total = max(progress.total, progress.done)
            if progress.cost < float("inf"):
                bar.set_postfix_str(
                    f"best {progress.cost:.2f}, bound {progress.lower_bound:.2f}", refresh=False
                )
            bar.update(progress.done - bar.n)

        yield tell


def _bar(progress: Progress, terminal: bool) -> Any:
    """Return the bar of one phase; away from a terminal it speaks late and seldom."""
    from tqdm import tqdm

    return tqdm(
        total=progress.total,
        desc=progress.phase,
        unit="subset",
        file=sys.stderr,
        leave=False,
        delay=0.5 if terminal else QUIET_S,
        mininterval=0.1 if terminal else QUIET_S,
    )


def _tell(result: Result, trip: Trip, json_file: str | None, plot_folder: Path | None) -> int:
    """Print and write a result; return the exit code."""
    import json

    from enumerate.result import Status
    from enumerate.show import format_result

    text = None
    if json_file is not None:
        text = json.dumps(result.to_dict(), allow_nan=False)
    if json_file == STDOUT:
        click.echo(text)
        if result.plan is None and result.diagnosis is not None:
            _echo(f"evrelax: {result.trip}: no plan: {result.diagnosis.reason}", err=True)
    else:
        _echo(format_result(result, trip))
    try:
        if json_file is not None and text is not None and json_file != STDOUT:
            Path(json_file).write_text(text + "\n", encoding="utf-8")
        if plot_folder is not None and result.plan is not None:
            from relax.plot import save_plots

            save_plots(result.plan, trip, plot_folder)
    except OSError as error:
        _fail(f"the plan was found but could not be written: {error}", NOT_WRITTEN)
    if result.plan is not None:
        return PLANNED
    return INFEASIBLE if result.status is Status.INFEASIBLE else STOPPED


def _save_ledger(file: str, trip: Trip, result: Result) -> None:
    """Write the proofs of a result."""
    from enumerate.evidence_file import save_proofs

    if not result.proofs:
        _fail("nothing is proved yet: no ledger was written", NOT_WRITTEN)
    try:
        save_proofs(file, trip, result)
    except OSError as error:
        _fail(f"the ledger could not be written: {error}", NOT_WRITTEN)


def _echo(text: str, err: bool = False) -> None:
    """Print text, in ASCII where the stream cannot do better."""
    from enumerate.table import printable

    stream = sys.stderr if err else sys.stdout
    click.echo(printable(text, stream.encoding), err=err)


if __name__ == "__main__":
    main()
