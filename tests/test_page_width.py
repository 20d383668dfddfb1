"""Whatever a command prints fits a terminal of 80 columns."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from click.testing import CliRunner
from trips import write_trip

from enumerate import audit, plan, save_proofs
from enumerate.cli import main
from enumerate.show import format_result
from relax import load_trip, shipped_trips
from relax.trip import Trip

WARM = ("--set", "route.ambient_c=15")


@pytest.mark.parametrize(
    "command",
    [
        ("trips",),
        ("versions",),
        ("plan", "paper-400km", "--certificate", *WARM),
        ("plan", "goteborg-stockholm-summer"),
        ("plan", "paper-400km", "--set", "start.soc=0.2", "--set", "end.soc_min=0.9"),
        ("pareto", "paper-400km", *WARM, "--points", "3", "--no-proof"),
        ("pareto", "paper-400km", "--set", "start.soc=0.11", "--no-proof"),
        ("sweep", "paper-400km", "--over", "route.ambient_c=10,15", "--over", "start.soc=0.2,0.9"),
    ],
)
def test_no_line_is_wider_than_eighty_columns(
    command: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # its name would count
    file = ("--file", "rows.jsonl") if command[0] == "sweep" else ()
    done = CliRunner().invoke(main, [*command, *file])
    assert done.exit_code in (0, 3) and done.stdout
    wide = [line for line in done.stdout.split("\n") if len(line) > 80]
    if command[0] == "versions":
        wide = [line for line in wide if not line.startswith("platform")]  # it is what it is
    assert not wide


def test_no_line_of_an_audit_is_wider_than_eighty_columns(tmp_path: Path) -> None:
    trip, file = write_trip(tmp_path, **{"start.soc": 0.45}), tmp_path / "trip.proofs"
    assert CliRunner().invoke(main, ["plan", str(trip), "--ledger", str(file)]).exit_code == 0
    done = CliRunner().invoke(main, ["audit", str(file), str(trip)])
    assert done.exit_code == 0 and max(map(len, done.stdout.split("\n"))) <= 80


def long_names(trip: Trip) -> Trip:
    """Return the trip with chargers named as on a map."""
    return dataclasses.replace(
        trip,
        chargers=tuple(
            dataclasses.replace(c, name=f"Trafikplats Jönköping-Huskvarna södra {c.name}, plats 12")
            for c in trip.chargers
        ),
    )


SLOW = {"goteborg-stockholm-winter", "long-1000km-winter"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * (n in SLOW)) for n in shipped_trips()]
)
def test_no_page_is_wider_than_eighty_columns(name: str, tmp_path: Path) -> None:
    trip = load_trip(name)
    found = plan(trip, gap=0.05, time_limit_s=10.0 if name in SLOW else 1.5, keep_proofs=True)
    pages = [format_result(found, trip), format_result(found)]
    if found.plan is not None:
        pages.append(str(found.certificate))
        renamed = long_names(trip)
        new = {c.name: r.name for c, r in zip(trip.chargers, renamed.chargers, strict=True)}
        stops = tuple(dataclasses.replace(s, charger=new[s.charger]) for s in found.plan.stops)
        named = dataclasses.replace(
            found,
            trip="a trip with a name that is so long that nobody would want to read all of it",
            chargers=tuple(new.values()),
            plan=dataclasses.replace(found.plan, stops=stops),
        )
        pages.append(format_result(named, renamed))
    save_proofs(tmp_path / "proofs", trip, found)
    pages.append(str(audit(tmp_path / "proofs", trip)))
    damaged = dataclasses.replace(
        audit(tmp_path / "proofs", trip), failures=("row of the chargers (0,): " + "wrong " * 40,)
    )
    pages.append(str(damaged))
    for page in pages:
        assert "\n\n\n" not in page and page == page.strip()
        for row in page.split("\n"):
            assert len(row) <= 80, row
            assert row == row.rstrip()
