"""Whatever a command prints fits a terminal of 80 columns."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from trips import write_trip

from enumerate.cli import main

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
