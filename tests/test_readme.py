"""README.md says what happens: its examples run, its outputs and its tables are the present ones.
So do the programs of docs/examples.md and the figures of docs/relaxation.md.

Words must be equal; numbers may differ by ``TOLERANCE``, since another processor may end
elsewhere in the last digits. Tables of measured figures are compared with the result files by
``pytest -m long tests/test_readme.py``; one that is out of date is printed as it should be.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import shlex
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from statistics import median

import pytest
from click.testing import CliRunner

from benchmarks.cases import select
from benchmarks.proofs import summarise as summarise_proofs
from benchmarks.rows import read_rows
from benchmarks.tightening import without
from enumerate import plan
from enumerate.cli import main
from relax import load_trip, make_instance
from relax.bound import relax_subset
from relax.branch import limit_count
from relax.reach import make_box

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
PROOFS = (ROOT / "docs" / "relaxation.md").read_text(encoding="utf-8")
RESULTS = ROOT / "benchmarks" / "results"
TOLERANCE = 0.03
"""Relative, and at least one unit of the last digit printed."""
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
CUT = "[...]"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def same_line(said: str, found: str) -> bool:
    """Equal words; numbers equal within the tolerance."""
    if NUMBER.sub("#", said).split() != NUMBER.sub("#", found).split():
        return False
    for a, b in zip(NUMBER.findall(said), NUMBER.findall(found), strict=True):
        unit = 10.0 ** -len(a.partition(".")[2])
        if abs(float(a) - float(b)) > max(TOLERANCE * abs(float(a)), 1.01 * unit):
            return False
    return True


def test_lines_are_compared_by_words_and_numbers() -> None:
    assert same_line("cost 100.00 SEK", "cost  102.9 SEK")
    assert not same_line("cost 100.00 SEK", "cost 103.1 SEK")
    assert not same_line("cost 100.00 SEK", "cost 100.00 EUR")
    assert same_line("gap 0.006 %", "gap 0.007 %") and not same_line("gap 0.006 %", "gap 0.016 %")


def assert_told(said: str, found: str) -> None:
    """Every line said is found, in order; between the marks, without anything left out."""
    lines = found.splitlines()
    at, may_skip = 0, False
    for line in said.splitlines():
        if line == CUT:
            may_skip = True
            continue
        if may_skip:
            while at < len(lines) and not same_line(line, lines[at]):
                at += 1
        assert at < len(lines), f"not in the output any more: {line!r}\n{found}"
        assert same_line(line, lines[at]), f"said    {line!r}\nprinted {lines[at]!r}"
        at, may_skip = at + 1, False
    assert may_skip or at == len(lines), f"the output goes on: {lines[at:]}"


def test_the_printed_plan() -> None:
    command, said = re.findall(
        r"<!-- output: evrelax (.*?) -->\n```text\n(.*?)^```$", README, re.MULTILINE | re.DOTALL
    )[0]
    done = CliRunner().invoke(main, shlex.split(command))
    assert done.exit_code == 0, done.output
    assert_told(said, done.stdout)


def test_python_blocks_print_what_follows_them() -> None:
    pairs = re.findall(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", README, re.M | re.S)
    assert pairs and len(pairs) == len(blocks("python"))
    for code, said in pairs:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, "README.md", "exec"), {})
        assert_told(said, printed.getvalue())


@pytest.mark.parametrize("title", re.findall(r"^## (.*)$", EXAMPLES, re.MULTILINE))
def test_an_example_prints_what_follows_it(
    title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (section,) = re.findall(rf"^## {re.escape(title)}$(.*?)(?=^## |\Z)", EXAMPLES, re.M | re.S)
    ((code, said),) = re.findall(
        r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", section, re.M | re.S
    )
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "examples.md", "exec"), {})
    assert_told(said, printed.getvalue())


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory that holds the trip of the page."""
    (trip,) = blocks("toml")
    (tmp_path / "my-trip.toml").write_text(trip, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_trip_file_loads_and_plans(in_folder: Path) -> None:
    trip = load_trip(in_folder / "my-trip.toml")
    assert [c.name for c in trip.chargers] == ["Odeshog", "Norrkoping"]
    result = plan(trip)
    assert result.is_feasible and result.lower_bound <= result.cost
    assert {s.charger for s in result.plan.stops} <= {"Odeshog", "Norrkoping"}  # type: ignore[union-attr]


def test_command_lines(in_folder: Path) -> None:
    commands = [
        shlex.split(line, comments=True)[1:]
        for block in blocks("sh")
        for line in block.splitlines()
        if line.startswith("evrelax ")
    ]
    assert len(commands) >= 13
    for command in commands:
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 0, (command, done.output)
    assert json.loads((in_folder / "plan.json").read_text(encoding="utf-8"))["plan"]["stops"]
    assert {f.suffix for f in (in_folder / "figures").iterdir()} == {".png", ".svg"}
    assert len((in_folder / "rows.jsonl").read_text(encoding="utf-8").splitlines()) == 4
    assert (in_folder / "trip.proofs").stat().st_size > 0
    assert {command[0] for command in commands} == set(main.commands)


def test_set_names_a_charger_with_a_space() -> None:
    (setting,) = re.findall(r'--set "(charger\.[^"]*)"', README)
    key, value = setting.split("=")
    trip = load_trip("paper-400km", overrides={key: float(value)})
    assert trip.chargers[1].power_kw == float(value)


def test_exit_codes_are_those_of_the_command() -> None:
    from enumerate import cli

    said = [int(code) for code in re.findall(r"^\| (\d) \| ", README, re.MULTILINE)]
    codes = [cli.PLANNED, cli.NOT_WRITTEN, cli.BAD_INPUT, cli.INFEASIBLE, cli.STOPPED]
    assert said == codes


def test_files_and_commands_named_exist() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert link.startswith("https://") or (ROOT / link).is_file(), link
    for path in set(re.findall(r"(?:docs|tests)/[\w.-]+\.\w+", README)):
        assert (ROOT / path).is_file(), path
    for module in set(re.findall(r"python -m (benchmarks[\w.]*)", README)):
        file = ROOT / (module.replace(".", "/") + ".py")
        assert file.is_file() or (file.with_suffix("") / "__main__.py").is_file(), module
    pages = {p.name for p in (ROOT / "docs").glob("*.md")} - {"index.md"}
    listed = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert pages == set(re.findall(r"\]\(([\w-]+\.md)\)", listed))


# ---------------------------------------------------------------- figures of docs/relaxation.md


@pytest.mark.parametrize("name", ["paper-400km", "goteborg-stockholm-winter"])
def test_bounds_of_families_are_those_of_the_page(name: str) -> None:
    trip = load_trip(name)
    chargers = tuple(range(len(trip.chargers)))
    family = make_instance(trip, (), undecided=chargers)
    box = make_box(family)
    together = relax_subset(family, limit_count(box, 2, 2)).lower_bound
    alone = [
        relax_subset(make_instance(trip, pair)).lower_bound for pair in combinations(chargers, 2)
    ]
    found = [together, min(bound for bound in alone if bound is not None)]
    if name == "paper-400km":
        found.insert(0, relax_subset(family).lower_bound)
    (text,) = re.findall(
        rf"`{name}` (?:\(`relax_subset`|the 28 pairs)(.*?)one by one", PROOFS, re.S
    )
    said = [float(number) for number in re.findall(r"\d+\.\d", text)]
    assert found == pytest.approx(said, rel=1e-3)


@pytest.mark.long  # the number depends on every choice of relax.tighten
def test_programs_of_a_proof_are_those_of_the_page() -> None:
    rows = re.findall(r"^\| `(paper/[\w-]+)` \| (\d+) \| (\d+) \|", PROOFS, re.MULTILINE)
    assert len(rows) == 4
    for name, as_it_is, warmer in rows:
        (case,) = select([name])
        found = plan(case.load(), gap=0.01).programs
        assert found == pytest.approx(float(as_it_is), rel=0.1, abs=2)
        with without("coldest drive"):
            found = plan(case.load(), gap=0.01).programs
        assert found == pytest.approx(float(warmer), rel=0.1, abs=2)


# ---------------------------------------------------------------- tables from benchmarks/results


def speed_table() -> str:
    value = json.loads((RESULTS / "speed.json").read_text(encoding="utf-8"))

    def row(words: str, solver: str, part: str) -> str:
        times = [r[solver][part] / r["evrelax"]["total_s"] for r in value["rounds"]]
        milliseconds = 1e3 * median(r[solver][part] for r in value["rounds"])
        ratio = "1" if solver == "evrelax" else f"{median(times):.2f}"
        return f"| {words} | {milliseconds:.0f} ms | {ratio} |"

    lines = [
        f"| one complete plan of `{value['trip']}`, one thread | time | times ours |",
        "|---|---:|---:|",
        row("evrelax: all 8 choices of stops, bounds, plan, replay", "evrelax", "total_s"),
    ]
    for solver in ("ipopt", "fatrop"):
        whole = f"{solver.upper()}, one start per choice: build, solve, judge"
        lines += [row(whole, solver, "total_s"), row("- of which solve", solver, "solve_s")]
    return "\n".join(lines)


def optimality_table() -> str:
    with (RESULTS / "optimality.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    cases: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    for row in rows:
        case = (row["ambient_c"], row["heat_pump_kw"], row["time_value_per_h"])
        cases.setdefault(case, {})[row["solver"]] = row
    ratios, gaps = [], []
    for by_solver in cases.values():
        assert all(row["feasible"] == "True" for row in by_solver.values())
        ours = by_solver["evrelax"]
        best = min(float(by_solver[s]["cost"]) for s in ("ipopt", "fatrop"))
        ratios.append(float(ours["cost"]) / best)
        cost = float(ours["replayed_cost"])
        gaps.append(100.0 * (cost - float(ours["lower_bound"])) / cost)

    def spent(solver: str) -> str:
        return f"{sum(float(r['total_s']) for r in rows if r['solver'] == solver):.0f} s"

    good = sum(ratio <= 1.0001 for ratio in ratios)
    mean = sum(ratios) / len(ratios)
    return "\n".join(
        [
            f"| {len(cases)} cases of `paper-400km` | |",
            "|---|---:|",
            f"| our cost / best of IPOPT and FATROP, mean | {mean:.5f} |",
            f"| worst | {max(ratios):.5f} |",
            f"| cases within 0.01 % or better | {good} of {len(cases)} |",
            f"| gap without `--gap`, least to largest | {min(gaps):.2f} to {max(gaps):.2f} % |",
            f"| time for all cases: evrelax | {spent('evrelax')} |",
            "| time for all cases: IPOPT, FATROP, up to 12 starts per choice "
            f"| {spent('ipopt')}, {spent('fatrop')} |",
        ]
    )


def memory_table() -> str:
    value = json.loads((RESULTS / "memory.json").read_text(encoding="utf-8"))
    return "\n".join(
        [
            f"| one cold `evrelax plan {value['trip']}` | |",
            "|---|---:|",
            f"| peak memory of its largest process | {value['peak_memory_mb']:.0f} MB |",
            f"| wall clock, imports included | {value['wall_s']:.1f} s |",
        ]
    )


def proofs_table() -> str:
    return summarise_proofs(read_rows(RESULTS / "proofs.csv"))


@pytest.mark.long  # who reruns a benchmark on another machine need not mend the page
@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("speed", speed_table),
        ("optimality", optimality_table),
        ("proofs", proofs_table),
        ("memory", memory_table),
    ],
)
def test_tables_are_those_of_the_result_files(name: str, table: Callable[[], str]) -> None:
    (said,) = re.findall(
        rf"<!-- figures: {name} -->\n(.*?)\n<!-- end -->", README, re.MULTILINE | re.DOTALL
    )
    now = table()
    assert said == now, f"README.md, table '{name}', should read:\n{now}"


def test_the_grid_study_is_that_of_its_result_file() -> None:
    page = (ROOT / "docs" / "grid-study.md").read_text(encoding="utf-8")
    with (RESULTS / "grid_study.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    grids = {(r["case"], float(r["step_km"]), int(r["cells"])): r for r in rows}
    assert len(grids) == len(rows)
    said = re.findall(r"^\| (.+?) \| .+? \| (\d) \| (\d+) \| [\d.]+ \| (\d+\.\d+) \|", page, re.M)
    assert len(said) == 45
    for case, step, cells, driven in said:
        row = grids[case, float(step), int(cells)]
        assert f"{float(row['replayed_cost']):.3f}" == driven
