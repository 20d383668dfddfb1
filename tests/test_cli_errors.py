"""What goes wrong on the command line is one line and an exit code: options, outputs, a second
Ctrl-C. Nothing is lost for it, and nothing but a regular file is ever replaced."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from trips import small_trip, write_trip

from enumerate import load_proofs, plan, search
from enumerate.cli import main

MODULE = [sys.executable, "-m", "enumerate.cli"]


@pytest.fixture
def trip(tmp_path: Path) -> Path:
    return write_trip(tmp_path, **{"start.soc": 0.45, "grid.step_km": 20.0, "grid.cells": 4})


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in arguments])


def told(done: Result) -> str:
    """Return the one line of a bad input."""
    assert done.exit_code == 2 and done.stdout == "" and done.stderr.count("\n") == 1, done.output
    assert done.stderr.startswith("evrelax: ")
    return done.stderr.removeprefix("evrelax: ").rstrip("\n")


# ---------------------------------------------------------------------------- options


@pytest.mark.parametrize(
    ("command", "option", "value", "shown", "allowed"),
    [
        ("plan", "--gap", "-1", "-1", "a number above 0 and below 1, e.g. 0.01 for 1 %"),
        ("plan", "--gap", "0", "0", "a number above 0 and below 1"),
        ("plan", "--gap", "1", "1", "a number above 0 and below 1"),
        ("plan", "--gap", "100", "100", "a number above 0 and below 1"),
        ("plan", "--gap", "inf", "inf", "a number above 0 and below 1"),
        ("plan", "--gap", "nan", "nan", "a number above 0 and below 1"),
        ("plan", "--gap", "abc", "'abc'", "a number above 0 and below 1"),
        ("plan", "--gap", "1\n2", r"'1\n2'", "a number above 0 and below 1"),
        ("plan", "--time-limit", "-1", "-1", "a number of seconds of at least 0, or 'inf'"),
        ("plan", "--time-limit", "nan", "nan", "a number of seconds"),
        ("plan", "--workers", "0", "0", "a whole number of at least 1"),
        ("plan", "--workers", "1.5", "1.5", "a whole number of at least 1"),
        ("plan", "--solver", "none", "'none'", "one of clarabel, osqp"),
        ("plan", "--set", "foo", "'foo'", "key=value"),
        ("plan", "--set", "=1", "'=1'", "key=value"),
        ("pareto", "--gap", "100", "100", "a number above 0 and below 1"),
        ("pareto", "--points", "1", "1", "a whole number of at least 2"),
        ("pareto", "--measure", "time", "'time'", "one of energy, cost"),
        ("pareto", "--time-limit", "x", "'x'", "a number of seconds"),
        ("pareto", "--latest-min", "0", "0", "a number of minutes above 0"),
    ],
)
def test_a_bad_option_is_one_line(
    trip: Path, command: str, option: str, value: str, shown: str, allowed: str
) -> None:
    line = told(call(command, trip, option, value))
    assert line.startswith(f"command line: {option}: {shown}; allowed: {allowed}")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["plan", "TRIP", "--gp", "3"], "--gp"),
        (["plan", "TRIP", "--gap"], "--gap"),
        (["plan"], "TRIP"),
        (["plan", "TRIP", "more"], "more"),
        (["pln"], "pln"),
        (["schema", "car"], "'car'; allowed: one of trip, vehicle"),
        (["sweep", "TRIP", "--over", "start.soc=1"], "--file"),
        (["sweep", "TRIP", "--over", "start.soc=1", "--file", "x", "--workers", "0"], "--workers"),
        (["audit", "FILE", "TRIP", "--set", "foo"], "--set: 'foo'; allowed: key=value"),
    ],
)
def test_what_is_unknown_or_missing_is_one_line(arguments: list[str], named: str) -> None:
    line = told(call(*arguments))
    assert line.startswith("command line: ") and named in line


def test_a_gap_of_one_or_more_proves_nothing_and_is_refused() -> None:
    for gap in (1.0, 100.0, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="above 0 and below 1"):
            plan(small_trip(), gap=gap)


def test_more_chargers_than_a_front_can_have_are_bad_input() -> None:
    assert "at most 10" in told(call("pareto", "long-1000km-winter"))


# ---------------------------------------------------------------------------- places


@pytest.fixture
def never(monkeypatch: pytest.MonkeyPatch) -> None:
    def planned(*_: object, **__: object) -> None:
        raise AssertionError("planned in vain")

    monkeypatch.setattr(search, "plan", planned)


@pytest.mark.usefixtures("never")
def test_a_ledger_replaces_no_pipe_and_no_folder(trip: Path, tmp_path: Path) -> None:
    pipe, folder, link = tmp_path / "pipe", tmp_path / "folder", tmp_path / "link"
    os.mkfifo(pipe)  # a device is refused for the same reason
    folder.mkdir()
    link.symlink_to(pipe)
    for place in (pipe, folder, link):
        line = told(call("plan", trip, "--ledger", place))
        assert line.startswith(f"command line: --ledger: '{place}"[:80])
        assert line.endswith("; allowed: a regular file, or a free name")
    assert pipe.is_fifo() and folder.is_dir() and link.is_symlink()


@pytest.mark.usefixtures("never")
def test_a_link_to_a_free_name_survives_a_trip_that_is_refused(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "target")
    assert call("plan", "nowhere", "--ledger", link).exit_code == 2
    assert link.is_symlink() and not (tmp_path / "target").exists()


def test_a_ledger_through_a_link_is_written_where_the_link_leads(
    trip: Path, tmp_path: Path
) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old", encoding="utf-8")
    link.symlink_to(target)
    done = call("plan", trip, "--ledger", link, "--quiet")
    assert done.exit_code == 0, done.output
    assert link.is_symlink() and load_proofs(target).trip == "small trip"


# ---------------------------------------------------------------------------- outputs


class Full(io.RawIOBase):
    """A stream on a device without space."""

    def writable(self) -> bool:
        return True

    def write(self, _: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("options", [[], ["--json", "-"], ["--certificate"]])
def test_a_full_output_is_one_line_and_the_proofs_are_written(
    trip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    errors = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(Full(), encoding="utf-8"))
    monkeypatch.setattr(sys, "stderr", errors)
    file = tmp_path / "proofs"
    with pytest.raises(SystemExit) as ended:
        main(["plan", str(trip), "-q", "--ledger", str(file), *options])
    monkeypatch.undo()
    errors.seek(0)
    line = errors.read()
    assert ended.value.code == 1 and line.count("\n") == 1, line
    assert line.startswith("evrelax: the result could not be written: standard output: no space")
    assert load_proofs(file).trip == "small trip"


@pytest.mark.parametrize(
    "arguments",
    [
        ["versions"],
        ["trips"],
        ["schema", "trip"],
        ["plan", "--help"],
        ["pareto", "TRIP", "--points", "2", "--no-proof", "-q"],
        ["sweep", "TRIP", "--over", "start.soc=0.45", "--file", "rows.jsonl", "-q"],
        ["audit", "proofs", "TRIP", "-q"],
    ],
)
@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no such device here")
def test_every_command_says_that_its_output_is_full(
    trip: Path, tmp_path: Path, arguments: list[str]
) -> None:
    """As the shell does it; the device is only written to, never named as a file to replace."""
    if "audit" in arguments:
        assert call("plan", trip, "--ledger", tmp_path / "proofs", "-q").exit_code == 0
    given = [str(trip) if a == "TRIP" else a for a in arguments]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*MODULE, *given],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(Path.cwd())},
        )
    assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
    assert "could not be written" in done.stderr and "no space left" in done.stderr


def test_a_closed_output_is_one_line(trip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(SystemExit) as ended:
        main(["plan", str(trip), "-q"])
    assert ended.value.code == 1


@pytest.mark.parametrize("arguments", [["schema", "trip"], ["plan", "TRIP", "-q"]])
def test_a_reader_that_leaves_is_no_error_to_tell(trip: Path, arguments: list[str]) -> None:
    """As ``| head`` does: nothing is said, nothing is claimed to be complete."""
    reads, writes = os.pipe()
    os.close(reads)
    given = [str(trip) if a == "TRIP" else a for a in arguments]
    done = subprocess.run(
        [*MODULE, *given], stdout=writes, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writes)
    assert done.returncode == 1 and done.stderr == "", done.stderr


# ---------------------------------------------------------------------------- exit codes


def test_a_second_ctrl_c_has_its_own_code(trip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("enumerate.show.format_result", again)
    done = call("plan", trip, "-q")
    assert done.exit_code == 130 and done.stderr.strip() == "evrelax: interrupted"


def test_a_second_ctrl_c_waits_for_no_thread() -> None:
    """A thread whose join was interrupted is not joined again, and its solver aborts at exit."""
    program = (
        "import threading, time\n"
        "from enumerate.cli_exit import STOPPED, abandon\n"
        "threading.Thread(target=time.sleep, args=(30,)).start()\n"
        "abandon('interrupted', STOPPED)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=20
    )
    assert done.returncode == 4 and done.stderr == "evrelax: interrupted\n"


def test_a_front_of_an_infeasible_trip_says_why(trip: Path, tmp_path: Path) -> None:
    low = ("--set", "start.soc=0.06", "-q")
    found = call("pareto", trip, *low)
    assert found.exit_code == call("plan", trip, *low).exit_code == 3
    assert "infeasible" in found.stdout and "the car gets to" in found.stdout
    pure = call("pareto", trip, *low, "--json", "-")
    assert pure.exit_code == 3 and json.loads(pure.stdout)["points"] == []
    assert pure.stderr.count("\n") == 1 and "no plan: the car gets to" in pure.stderr
    early = call("pareto", trip, "-q", "--latest-min", "0.1")
    assert early.exit_code == 3 and "the time for charging and detours" in early.stdout


def test_a_front_that_was_stopped_is_not_proved_to_be_empty(trip: Path) -> None:
    done = call("pareto", trip, "-q", "--time-limit", "0", "--set", "start.soc=0.4")
    assert done.exit_code == 4 and "no plan found (time limit reached)" in done.stdout


def test_the_help_of_every_command_names_its_exit_codes() -> None:
    for command, codes in (
        ("plan", (0, 1, 2, 3, 4, 130)),
        ("pareto", (0, 1, 2, 3, 4)),
        ("sweep", (0, 1, 2, 4)),
        ("audit", (0, 1, 2, 4)),
    ):
        text = " ".join(call(command, "--help").stdout.split())
        said = text.partition("Exit codes: ")[2].partition("Options")[0]
        for code in codes:
            assert f"{code} " in said, (command, code)
    root = Path(__file__).resolve().parents[1]
    for page in ("README.md", "docs/audit.md"):
        content = " ".join((root / page).read_text(encoding="utf-8").split())
        assert "4 if interrupted" in content or "4 if it was interrupted" in content, page


# ---------------------------------------------------------------------------- audits


def test_proofs_of_other_numbers_are_told_from_those_of_another_trip(
    trip: Path, tmp_path: Path
) -> None:
    file = tmp_path / "proofs"
    assert call("plan", trip, "--ledger", file, "-q").exit_code == 0
    line = told(call("audit", file, trip, "--set", "start.soc=0.46"))
    assert line == (
        f"{file}: proofs of the trip 'small trip' with other numbers; "
        "allowed: proofs with the same numbers (--set as when planning)"
    )
    line = told(call("audit", file, trip, "--set", "start.soc=0.46", "--set", "name=other"))
    assert line.startswith(f"{file}: proofs of the trip: 'small trip'; allowed: ")
    assert "'other'" in line


def test_names_are_told_once(tmp_path: Path) -> None:
    line = told(call("audit", tmp_path / "Ft", "paper-400km"))
    assert line == f"proofs: '{tmp_path / 'Ft'}'; allowed: a file that exists"
    assert told(call("plan", "nowhere")).startswith("trip: 'nowhere'; allowed: a .toml file")
