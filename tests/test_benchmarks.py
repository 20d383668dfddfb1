"""The comparison: rows that resume, claims that are judged, a page that says where we lose."""

from __future__ import annotations

import csv
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from claimed import row

from benchmarks import compare, evidence, floor, judges, report
from benchmarks.cases import CASES, SMOKE, Case, digest, select
from benchmarks.compare import COLUMNS, KEY
from benchmarks.contestants import CONTESTANTS, FAST, OURS, Contestant, find
from benchmarks.judge import judge
from benchmarks.measured import PlanTask, measure_plan
from benchmarks.probe import watch
from benchmarks.reference.polish import polish, release
from benchmarks.rows import Row, RowFile, read_rows
from benchmarks.runs import Limits
from benchmarks.sources import code_digest
from benchmarks.verdicts import latest
from benchmarks.worker import Worker, WorkerError
from enumerate import plan
from relax import idle_controls, make_instance
from relax.simulate import is_feasible

# ------------------------------------------------------------------------------- cases and code


def test_cases_have_unique_names_and_every_group() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    groups = [case.group for case in CASES]
    assert groups.count("paper") == 27 and groups.count("random") >= 10
    assert groups.count("corridor") >= 2
    assert [c.name for c in select(["random/0[12]"])] == ["random/01", "random/02"]
    with pytest.raises(ValueError, match="no case matches 'paper/nothing'"):
        select(["paper/nothing"])
    with pytest.raises(ValueError, match="unknown solver 'nobody'"):
        find(["nobody"])


def test_the_digest_of_a_trip_sees_maps_and_forgets_caches() -> None:
    trip = SMOKE.load()
    before = digest(trip)
    plan(trip)
    assert digest(trip) == before
    cop = trip.vehicle.heat_pump_cop
    other = replace(trip.vehicle, heat_pump_cop=replace_value(cop))
    assert digest(replace(trip, vehicle=other)) != before


def replace_value(table: Any) -> Any:
    values = table.f.copy()
    values[0] += 1e-9
    return type(table)(table.x, values, table.name)


def test_the_digest_of_code_ignores_comments_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.sources.ROOT", tmp_path)
    (tmp_path / "some").mkdir()
    seen = []
    for text in (
        '"""A."""\nimport some.other\nx = 1\n',
        '"""B."""\nimport some.other\nx = 1  # why\n',
        '"""B."""\nimport some.other\nx = 2\n',
    ):
        (tmp_path / "some" / "one.py").write_text(text, encoding="utf-8")
        (tmp_path / "some" / "other.py").write_text("y = 1\n", encoding="utf-8")
        clear_caches()
        seen.append(code_digest("some.one", ("some",)))
    (tmp_path / "some" / "other.py").write_text("y = 2\n", encoding="utf-8")
    clear_caches()
    seen.append(code_digest("some.one", ("some",)))
    clear_caches()
    assert seen[0] == seen[1] and len(set(seen)) == 3


def clear_caches() -> None:
    from benchmarks import sources

    sources._tree.cache_clear()
    sources.code_digest.cache_clear()


# ------------------------------------------------------------------------------------- watching


def test_watching_changes_no_result_and_leaves_nothing_behind() -> None:
    def held() -> list[Any]:
        return [vars(sys.modules[home])[name] for home, name in places]

    places = (
        ("relax.solve", "solve_cone"),
        ("relax.bound", "solve_cone"),
        ("relax.refinement", "refine"),
        ("relax.solve", "clarabel"),
    )
    trip = SMOKE.load()
    before = held()
    plain = plan(trip)
    with watch() as probe:
        seen = plan(trip)
        assert all(new is not old for new, old in zip(held(), before, strict=True))
    assert held() == before
    assert (seen.cost, seen.lower_bound) == (plain.cost, plain.lower_bound)
    assert probe.programs == sum(r.programs for r in seen.ledger.rows)
    assert len(probe.reported_s) >= probe.programs  # a solve may be repeated with refinement
    assert 0.0 < sum(probe.reported_s) < probe.parts_s()["solve"]


def test_parts_of_the_work_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.measured.REPEATS", 1)
    row = measure_plan(PlanTask(SMOKE.load(), 0.02, 60.0))
    parts = sum(row[f"{part}_s"] for part in ("assembly", "reach", "solve", "certify"))
    assert row["ended"] == "done" and 0.0 < parts < row["total_s"]
    assert row["rest_s"] > -1e-3 and row["memory_mb"] >= row["memory_before_mb"] > 10.0


# --------------------------------------------------------------------------------------- judging


def test_the_judge_does_not_believe() -> None:
    trip = SMOKE.load()
    instance = make_instance(trip, (0, 1))
    assert judge(trip, (0, 1), idle_controls(instance, (25.0, 10.0))).outcome == "holds"
    drained = make_instance(trip, (1,))
    verdict = judge(trip, (1,), idle_controls(drained, (0.1,)))
    assert verdict.outcome == "fails" and verdict.replayed_cost == math.inf and verdict.reason
    hurried = replace(trip, chargers=tuple(replace(c, max_dwell_h=0.01) for c in trip.chargers))
    verdict = judge(hurried, (0, 1), idle_controls(instance, (25.0, 10.0)))
    assert verdict.outcome == "fails" and "dwell beyond the longest" in verdict.reason


def test_what_a_solver_leaves_when_it_gives_up_is_judged_not_raised() -> None:
    trip = SMOKE.load()
    instance = make_instance(trip, (0, 1))
    controls = idle_controls(instance, (25.0, 10.0))
    first, second = controls.stops
    empty = replace(first, energy_kwh=-1.0, power_kw=np.zeros_like(first.power_kw))
    broken = replace(controls, stops=(empty, second))
    _, trajectory = polish(instance, release(instance, broken))
    assert not is_feasible(trajectory)
    whole, trajectory = polish(instance, release(instance, controls))
    assert is_feasible(trajectory) and whole.stops[0].energy_kwh > 1.0


# ---------------------------------------------------------------------------------------- resume


def test_rows_are_written_as_they_come_and_never_twice(tmp_path: Path) -> None:
    target = tmp_path / "rows.csv"
    calls: list[tuple[str, str]] = []

    def run(case: Case, contestant: Contestant, limits: Limits) -> Row:
        calls.append((case.name, contestant.name))
        if len(calls) == 6:
            raise KeyboardInterrupt
        slow = contestant.name == OURS
        return row(case.name, contestant.name, 10.0, 60.0 if slow else 0.1 * len(calls))

    cases = (SMOKE, replace(SMOKE, name="smoke/again"))
    contestants = find([FAST, OURS])
    with pytest.raises(KeyboardInterrupt):
        compare.compare(cases, contestants, RowFile(target, COLUMNS, KEY), repeats=3, run=run)
    first = read_rows(target)
    assert [(r["case"], r["solver"]) for r in first] == [
        (SMOKE.name, OURS),  # slow: once, written at once
        (SMOKE.name, FAST),
    ]
    assert float(first[1]["total_s"]) == pytest.approx(0.3)  # the median of runs 1, 3, 4
    last = target.read_text(encoding="utf-8").splitlines()[-1]
    with target.open("a", encoding="utf-8") as stream:
        stream.write(last[:-2])  # what a killed process leaves
    file = RowFile(target, COLUMNS, KEY)
    added = compare.compare(cases, contestants, file, repeats=3, run=run)
    assert added == 2 and len(read_rows(target)) == 4
    assert compare.compare(cases, contestants, file, repeats=3, run=run) == 0
    changed = replace(SMOKE, load=lambda: replace(SMOKE.load(), start_soc=0.8))
    assert compare.compare((changed,), contestants, file, repeats=1, run=run) == 2
    with pytest.raises(ValueError, match="other columns"):
        RowFile(target, COLUMNS[:-1], KEY)


def test_who_is_stopped_at_our_time_gets_it(tmp_path: Path) -> None:
    late = next(c for c in CONTESTANTS if c.needs_our_time)
    given: list[float] = []

    def run(case: Case, contestant: Contestant, limits: Limits) -> Row:
        given.append(limits.our_time_s)
        return row(case.name, contestant.name, 10.0, 2.5)

    file = RowFile(tmp_path / "rows.csv", COLUMNS, KEY)
    assert compare.compare((SMOKE,), (late,), file, repeats=1, run=run) == 0
    assert compare.compare((SMOKE,), (*find([OURS]), late), file, repeats=1, run=run) == 2
    assert given == [math.inf, 2.5]


def test_a_run_that_hangs_or_fails_costs_its_row_only() -> None:
    with Worker() as worker:
        with pytest.raises(WorkerError, match="stopped after"):
            worker.run("time", "sleep", (60.0,), 0.2)
        with pytest.raises(WorkerError, match="the process died, exit code 3"):
            worker.run("os", "_exit", (3,), 60.0)
        with pytest.raises(WorkerError, match="ValueError"):
            worker.run("math", "sqrt", (-1.0,), 60.0)
        assert worker.run("math", "sqrt", (4.0,), 60.0) == 2.0


# ------------------------------------------------------------------------- smoke and the page


def test_smoke_from_rows_to_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    target = tmp_path / "compare.csv"
    file = RowFile(target, COLUMNS, KEY)
    assert compare.compare((SMOKE,), find([FAST, OURS]), file, repeats=1) == 2
    by = latest(read_rows(target))[SMOKE.name]
    for name in (FAST, OURS):
        assert by[name]["outcome"] == "holds"
        assert float(by[name]["lower_bound"]) <= float(by[name]["replayed_cost"])
        assert float(by[name]["claimed_cost"]) == pytest.approx(
            float(by[name]["replayed_cost"]), rel=1e-9
        )
    assert float(by[OURS]["lower_bound"]) > float(by[FAST]["lower_bound"])
    page = tmp_path / "page.md"
    code = report.main(["--results", str(tmp_path), "--page", str(page)])
    text = page.read_text(encoding="utf-8")
    assert code == 0 and f"{float(by[FAST]['replayed_cost']):.3f}" in text
    for link in [part.split(")")[0] for part in text.split("](")[1:]]:
        assert (tmp_path / link).stat().st_size > 1000
    assert capsys.readouterr().out.strip() in text


def test_floor_writes_both_gaps_and_resumes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "floor.csv"
    monkeypatch.setattr(floor, "run_task", lambda worker, task: measure_plan(task))
    monkeypatch.setattr("benchmarks.measured.REPEATS", 1)
    assert floor.main(["--cases", SMOKE.name, "--file", str(target)]) == 0
    with target.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [r["asked_gap"] for r in rows] == ["", "0.01"]
    assert all(0.0 < float(r["clarabel_s"]) < float(r["total_s"]) for r in rows)
    assert int(rows[1]["programs"]) > int(rows[0]["programs"])
    assert floor.main(["--cases", SMOKE.name, "--file", str(target)]) == 0
    assert len(read_rows(target)) == 2 and "| 1 % | 1 |" in capsys.readouterr().out


def test_audits_are_measured_by_round_and_resume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Worker, "run", in_this_process)
    tasks = (evidence.Task("smoke", SMOKE.load, 0.05), evidence.Task("other", SMOKE.load, 0.1))
    monkeypatch.setattr(evidence, "TASKS", tasks)
    target = tmp_path / "evidence.csv"
    command = ["--file", str(target), "--repeats", "2"]
    assert evidence.main([*command, "--trips", "smoke"]) == 0
    rows = read_rows(target)
    assert [row["round"] for row in rows] == ["1", "2"]
    for found in rows:
        assert found["holds"] == "True" and int(found["boxes"]) > 1 < int(found["programs"])
        assert 0.0 < float(found["audit_s"]) and float(found["duals_mb"]) > 0.0
        assert float(found["lower_bound"]) >= 0.95 * float(found["cost"])
    said = capsys.readouterr().out
    assert f"| `smoke` (N = 2) | 5 % | {rows[0]['boxes']} | 0 |" in said
    assert "Medians of 2 rounds." in said
    assert evidence.main(command) == 0
    assert read_rows(target)[:2] == rows and len(read_rows(target)) == 4
    with pytest.raises(SystemExit):
        evidence.main(["--trips", "nowhere"])
    newer = rows[0] | {"version": "new", "boxes": "99", "holds": "False"}
    text = evidence.table([*rows, newer])
    assert "| 99 |" in text and "Medians of 1 round." in text  # rows of two codes are not mixed
    assert "Audits that do not hold: smoke." in text


def in_this_process(
    worker: Worker, module: str, function: str, arguments: tuple[Any, ...], limit_s: float
) -> Any:
    return getattr(sys.modules[module], function)(*arguments)


def test_plans_are_made_and_judged_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, target = tmp_path / "compare.csv", tmp_path / "judges.csv"
    file = RowFile(rows, COLUMNS, KEY)
    compare.compare((SMOKE,), find([FAST]), file, repeats=1)
    command = ["--rows", str(rows), "--file", str(target)]
    assert judges.main(command) == 0 == judges.main(command)
    (again,) = read_rows(target)
    assert judges.is_same_plan(again) and judges.moved(again) < 1e-9
    assert "1 of 1 rows have the same plan again" in capsys.readouterr().out
