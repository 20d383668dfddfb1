"""The command line: pure JSON, exit codes, one clear line for bad input, nothing in vain."""

from __future__ import annotations

import json
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess, run

import jsonschema
import pytest
from click.testing import CliRunner, Result
from trips import write_trip

import enumerate.audit  # noqa: F401 - one test replaces a name in it
import relax
from enumerate import cli_options, display, evidence_file, explore, load_proofs, search
from enumerate import plan as plan_trip
from enumerate.cli import main
from enumerate.evidence_file import save_evidence


@pytest.fixture
def trip(tmp_path: Path) -> Path:
    return write_trip(tmp_path, **{"start.soc": 0.45})


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in arguments])


def shell(*arguments: object, **options: object) -> CompletedProcess[str]:
    command = [sys.executable, "-m", "enumerate.cli", *(str(a) for a in arguments)]
    return run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload,no-any-return]


def test_json_is_the_only_thing_on_stdout(trip: Path) -> None:
    done = shell("plan", trip, "--json", "-")
    assert done.returncode == 0, done.stderr
    value = json.loads(done.stdout)  # would fail on anything before or after the object
    assert done.stdout.count("\n") == 1 and done.stderr == ""
    assert value["status"] in ("optimal", "feasible") and value["cost"] > 0
    assert value["lower_bound"] <= value["cost"]
    assert value["plan"]["stops"][0]["charger"] in value["rows"][-1]["stops"]
    assert sum(value["subsets"][k] for k in ("planned", "bounded", "infeasible", "unproved")) == 4


def test_exit_codes_of_the_process(trip: Path) -> None:
    bad = shell("plan", trip, "--json", "-", "--set", "charger.1.power_kw=-3")
    assert bad.returncode == 2 and bad.stdout == ""
    assert bad.stderr.startswith("evrelax: ") and bad.stderr.count("\n") == 1
    assert "charger.1.power_kw" in bad.stderr and "-3" in bad.stderr and "allowed" in bad.stderr
    beyond = shell(
        "plan", trip, "--json", "-", "--set", "start.soc=0.1", "--set", "end.soc_min=0.9"
    )
    assert beyond.returncode == 3, beyond.stderr
    value = json.loads(beyond.stdout)
    assert value["status"] == "infeasible" and value["cost"] is None and value["plan"] is None
    assert "no plan" in beyond.stderr and value["diagnosis"]["reason"] in beyond.stderr


def test_table_and_files(trip: Path, tmp_path: Path) -> None:
    file, folder = tmp_path / "out.json", tmp_path / "plots"
    done = call("plan", trip, "--json", file, "--plot", folder, "--quiet")
    assert done.exit_code == 0, done.output
    value = json.loads(file.read_text(encoding="utf-8"))
    assert f"{value['cost']:.2f} {value['currency']}" in done.stdout and done.stderr == ""
    assert {p.suffix for p in folder.iterdir()} == {".png", ".svg"}


def test_same_answer_as_the_library(trip: Path) -> None:
    settings = {"route.ambient_c": 0, "start.battery_temperature_c": 5.0}
    done = call(
        "plan", trip, "--json", "-", *(f"--set={k}={v}" for k, v in settings.items()),
        "--all", "--workers", 2,
    )  # fmt: skip
    result = plan_trip(relax.load_trip(trip, settings), prune=False)
    value, expected = json.loads(done.stdout), result.to_dict()
    for found in (value, expected):
        del found["timings_s"]
    assert value == expected


@pytest.mark.parametrize("options", [(), ("--gap", 0.05), ("--quiet",)])
def test_many_chargers_and_none_within_reach_end_with_a_reason(options: tuple[object, ...]) -> None:
    """The first family is proved infeasible: there is nothing yet that progress could speak of."""
    done = shell("plan", "goteborg-stockholm-winter", "--set", "start.soc=0.15", *options)
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    assert "256 choices of stops: 256 proved infeasible." in done.stdout
    assert "start.soc of about" in done.stdout


@pytest.mark.parametrize(("cores", "used"), [(1, "1"), (3, "3"), (64, "4")])
def test_a_plan_uses_the_cores_it_may_use(
    cores: int, used: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    assert cli_options.workers() == used
    monkeypatch.delattr(os, "sched_getaffinity")  # a system without it
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert cli_options.workers() == used


def test_a_ledger_is_written_and_audited(trip: Path, tmp_path: Path) -> None:
    file = tmp_path / "trip.proofs"
    done = call("plan", trip, "--gap", 0.05, "--ledger", file, "--quiet")
    assert done.exit_code == 0, done.output
    audited = shell("audit", file, trip)
    assert audited.returncode == 0 and audited.stderr == "", audited.stderr
    assert "every claim holds" in audited.stdout and "4 choices of stops" in audited.stdout
    assert re.search(r"^gap +\d+\.\d+ %\.$", audited.stdout, flags=re.M)
    other = call("audit", file, trip, "--set", "start.soc=0.46")
    assert other.exit_code == 2 and other.stdout == "" and other.stderr.count("\n") == 1
    assert "with the same numbers" in other.stderr
    for wrong in (tmp_path / "nothing", trip):
        refused = call("audit", wrong, trip)
        assert refused.exit_code == 2 and refused.stderr.startswith(f"evrelax: proofs: '{wrong}'; ")
    assert call("audit", file, "nowhere").exit_code == 2


def test_a_false_ledger_fails_and_says_where(trip: Path, tmp_path: Path) -> None:
    file = tmp_path / "trip.proofs"
    assert call("plan", trip, "--ledger", file, "--quiet").exit_code == 0
    evidence = load_proofs(file)
    nodes = tuple(replace(n, bound=2.0 * n.bound) for n in evidence.nodes)
    save_evidence(file, replace(evidence, nodes=nodes))
    done = call("audit", file, trip)
    assert done.exit_code == 1 and "claims fail" in done.stdout and "FAILS   node" in done.stdout


def test_a_ledger_that_cannot_be_written(
    trip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert call("plan", trip, "--ledger", tmp_path).exit_code == 2
    assert call("plan", trip, "--ledger", tmp_path / "no" / "folder").exit_code == 2

    def full(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(evidence_file, "save_proofs", full)
    done = call("plan", trip, "--ledger", tmp_path / "new")
    assert done.exit_code == 1 and "destination" in done.stdout and "no space left" in done.stderr


def test_the_certificate_is_printed_when_asked_for(trip: Path) -> None:
    done = call("plan", trip, "--certificate", "--quiet")
    assert done.exit_code == 0 and "convex by structure" in done.stdout
    assert "convex by structure" not in call("plan", trip, "--quiet").stdout
    pure = call("plan", trip, "--certificate", "--quiet", "--json", "-")
    assert json.loads(pure.stdout)["cost"] > 0 and "convex by structure" in pure.stderr


def test_an_interrupted_audit_confirms_nothing(
    trip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["enumerate.audit"], "audit", interrupted)
    done = call("audit", tmp_path / "any", trip)
    assert done.exit_code == 4 and done.stdout == "" and done.stderr.count("\n") == 1


def test_infeasible_says_how_far_and_what_would_help(trip: Path) -> None:
    done = call("plan", trip, "--set", "start.soc=0.06", "--set", "charger.1.position_km=119")
    assert done.exit_code == 3, done.output
    assert "the car gets to" in done.stdout and "remedy" in done.stdout


def test_stopped_without_a_plan(trip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(explore, "relax_node", interrupted)
    done = call("plan", trip, "--workers", 1)
    assert done.exit_code == 4, done.output
    assert "interrupted" in done.stdout and "status  unknown" in done.stdout
    monkeypatch.setattr(search, "plan", interrupted)
    done = call("plan", trip)
    assert done.exit_code == 4 and done.stderr.count("\n") == 1


def test_interrupted_with_a_plan_prints_it(trip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, calls = explore.refine_node, []

    def second_fails(*arguments: object, **options: object) -> object:
        calls.append(1)
        if len(calls) > 1:
            raise KeyboardInterrupt
        return real(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(explore, "refine_node", second_fails)
    done = call("plan", trip, "--all", "--workers", 1)
    assert done.exit_code == 0, done.output
    assert "interrupted" in done.stdout and "destination" in done.stdout


@pytest.mark.parametrize("option", ["--json", "--plot"])
def test_outputs_are_checked_before_planning(
    trip: Path, tmp_path: Path, option: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("planned in vain")

    monkeypatch.setattr(search, "plan", never)
    blocker = tmp_path / "file"
    blocker.write_text("kept", encoding="utf-8")
    done = call("plan", trip, option, blocker / "below")
    assert done.exit_code == 2 and done.stdout == ""
    assert done.stderr.startswith(f"evrelax: command line: {option}: ")
    assert done.stderr.count("\n") == 1
    assert call("plan", trip, "--json", tmp_path).exit_code == 2  # a folder is no file
    assert call("plan", trip, "--plot", blocker).exit_code == 2  # a file is no folder
    assert blocker.read_text(encoding="utf-8") == "kept"


def test_no_output_replaces_another_or_the_trip(tmp_path: Path) -> None:
    trip, out = write_trip(tmp_path), tmp_path / "out"
    before = trip.read_bytes()
    for options, other in (
        (["--json", str(out), "--ledger", str(out)], "--json"),
        (["--json", str(trip)], "the trip"),
        (["--ledger", str(tmp_path / "." / trip.name)], "the trip"),
    ):
        found = CliRunner().invoke(main, ["plan", str(trip), "-q", *options])
        assert found.exit_code == 2
        assert found.stderr.endswith(f"allowed: another file than that of {other}\n")
    assert trip.read_bytes() == before and not out.exists()


def test_a_refused_trip_leaves_no_json_file_and_keeps_an_old_one(tmp_path: Path) -> None:
    new, old = tmp_path / "new.json", tmp_path / "old.json"
    old.write_text("kept", encoding="utf-8")
    assert call("plan", "nowhere", "--json", new).exit_code == 2
    assert call("plan", "nowhere", "--json", old).exit_code == 2
    assert not new.exists() and old.read_text(encoding="utf-8") == "kept"


def test_values_are_toml_or_strings() -> None:
    texts = ("a=1", "b = [1, 2]", "c=true", "d=plain words", "e=", 'f="1"', "g=1\nh=2", "i=x=y")
    found = cli_options.settings(None, None, texts)
    assert found == {
        "a": 1, "b": [1, 2], "c": True, "d": "plain words", "e": "", "f": "1", "g": "1\nh=2",
        "i": "x=y",
    }  # fmt: skip


def test_all_choices_of_many_chargers_are_not_planned() -> None:
    done = call("plan", "long-1000km-winter", "--all")
    assert done.exit_code == 2 and done.stdout == ""
    assert done.stderr == (
        "evrelax: long-1000km-winter: charger: '20 of them'; allowed: at most 10 with --all\n"
    )


def test_too_many_chargers_are_bad_input(trip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "MAX_CHARGERS", 1)
    done = call("plan", trip)
    assert done.exit_code == 2 and "charger" in done.stderr and "at most 1" in done.stderr


def test_progress_goes_to_stderr_only_where_wanted(trip: Path) -> None:
    with display.show_progress(quiet=True) as report:
        assert report is None
    with display.show_progress(quiet=False) as report:
        assert report is not None
        for phase in ("relax", "refine"):
            report(search.Progress(phase, 1, 2, 3.0, 2.0))
            report(search.Progress(phase, 2, 2, 3.0, 2.0))


def test_ascii_terminal_gets_ascii(tmp_path: Path) -> None:
    trip = write_trip(tmp_path, **{"charger.1.name": "Göteborg", "start.soc": 0.45})
    done = shell(
        "plan", trip, env={"PYTHONIOENCODING": "ascii:strict", "PYTHONPATH": str(Path.cwd())}
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.isascii() and "Goteborg" in done.stdout


def test_lists_everything_shipped() -> None:
    done = call("trips")
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    for name in (*relax.shipped_trips(), *relax.shipped_vehicles(), *relax.shipped_routes()):
        (line,) = [row for row in lines if row.startswith(f"  {name} ")]
        assert len(line.split()) > 3, "a line says what it is"


@pytest.mark.parametrize("what", ["trip", "vehicle"])
def test_schema_is_json_schema(what: str) -> None:
    done = call("schema", what)
    assert done.exit_code == 0
    jsonschema.Draft202012Validator.check_schema(json.loads(done.stdout))


def test_versions_name_every_dependency() -> None:
    done = call("versions")
    assert done.exit_code == 0
    for name in ("evrelax", "python", "platform", "numpy", "scipy", "clarabel", "osqp"):
        assert f"\n{name} " in "\n" + done.stdout
    assert call("--version").exit_code == 0


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom enumerate.cli import main\n"
        "assert {'audit', 'pareto', 'plan', 'sweep'} <= set(main.commands)\n"
        "try:\n    main(['plan', '--help'])\nexcept SystemExit as e:\n    assert not e.code\n"
        "heavy = {'numpy', 'scipy', 'clarabel', 'matplotlib', 'pydantic', 'tqdm'}\n"
        "sys.exit(str(heavy & set(sys.modules)) if heavy & set(sys.modules) else 0)"
    )
    done = run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "--time-limit" in done.stdout


def test_lazy_exports_are_complete_and_prefer_the_function() -> None:
    code = (
        "import relax.replay, relax.execute, relax.simulate\n"
        "from relax import execute, replay, simulate\n"
        "assert callable(execute) and callable(replay) and callable(simulate)\n"
        "import relax, importlib\n"
        "pack = importlib.import_module('enumerate')\n"
        "for module in (relax, pack):\n"
        "    assert set(module.__all__) == set(module._homes)\n"
        "    assert set(module.__all__) <= set(dir(module))\n"
        "    for name in module.__all__:\n"
        "        value = getattr(module, name)\n"
        "        assert value.__name__ == name and value.__module__.startswith(module.__name__)\n"
        "try:\n    relax.nothing\nexcept AttributeError as e:\n    assert 'nothing' in str(e)\n"
        "else:\n    raise SystemExit('no error')\n"
    )
    done = run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
