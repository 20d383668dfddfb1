"""The page of the comparison: figures from rows, and a list at its head that says where we lose."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from claimed import row

from benchmarks import charts, judges, report, scale, speed
from benchmarks.asked import asked, missed
from benchmarks.cases import SMOKE
from benchmarks.contestants import CONTESTANTS, FAST, OURS
from benchmarks.losses import losses
from benchmarks.machine import versions
from benchmarks.measured import PlanTask, measure_plan
from benchmarks.rows import Row
from benchmarks.runs import Limits
from benchmarks.summary import shifted_mean, summarise
from benchmarks.verdicts import latest


def test_a_wrong_claim_is_counted_as_wrong() -> None:
    rows = [row("a", FAST, 100.0, 1.0), row("a", OURS, 100.0, 2.0)]
    rows.append(row("a", "ipopt", 100.0, 1.0, claimed_cost=95.0))
    rows.append(row("a", "fatrop", 100.0, 1.0, outcome="repaired"))
    rows.append(row("b", FAST, 50.0, 1.0, lower_bound=50.1))
    solvers = summarise(rows)["solvers"]
    assert [solvers[n]["correct"] for n in (FAST, "ipopt", "fatrop")] == [2, 0, 0]
    assert solvers["fatrop"]["held"] == 1 == solvers["fatrop"]["repaired"]
    assert solvers[FAST]["bounds_undercut"] == 1 and solvers[OURS]["bounds_undercut"] == 0


def test_an_enumeration_ends_at_the_time_limit_and_says_so() -> None:
    pytest.importorskip("casadi")
    answer = next(c for c in CONTESTANTS if c.name == "fatrop").run(SMOKE.load(), Limits(0.0))
    assert answer.controls is None and answer.subsets == 0
    rows = [row("paper/a", "fatrop", math.nan, 1.0, message=answer.message)]
    rows.append(row("paper/b", "fatrop", 10.0, 1.0, message="0 solves failed"))
    assert summarise(rows)["solvers"]["fatrop"]["cut"] == 1


def test_two_versions_of_a_solver_say_what_they_ran() -> None:
    rows = [row("paper/a", FAST, 100.0, 1.0), row("random/b", FAST, 9.0, 1.0, version="2")]
    rows.append(row("paper/a", OURS, 100.0, 1.0))
    solvers = summarise(rows)["solvers"]
    assert solvers[FAST]["versions"] == ["1 (paper)", "2 (random)"]
    assert solvers[OURS]["versions"] == ["1"]


def test_only_rows_of_one_command_count_as_one_run() -> None:
    rows = [row(case, FAST, 100.0, 1.0) for case in ("paper/a", "paper/b", "paper/c")]
    rows += [row("paper/a", "ipopt", 100.0, 2.0), row("paper/b", "ipopt", 100.0, 2.0, run="later")]
    rows += [row("paper/c", "ipopt", 100.0, 2.0, run="")]
    (against,) = summarise(rows)["against"]
    assert against["timed"] == 3 and against["together"] == ["paper/a"]


def test_of_equal_rows_the_last_counts() -> None:
    rows = [row("a", FAST, 100.0, 1.0), row("a", FAST, 99.0, 3.0)]
    assert latest(rows)["a"][FAST]["total_s"] == 3.0
    assert shifted_mean([]) != shifted_mean([])  # NaN, not an error


def test_the_list_at_the_head_names_what_we_lose() -> None:
    rows = []
    for case, cost in (("paper/a", 100.0), ("paper/b", 200.0)):
        rows += [row(case, FAST, cost, 1.0), row(case, OURS, cost, 5.0)]
        rows.append(row(case, "fatrop", cost, 0.5, build_s=2.0))
    rows.append(row("paper/a", "ipopt", 97.0, 0.4, outcome="repaired"))
    rows.append(row("random/c", FAST, math.nan, 1.0))
    rows.append(row("random/c", OURS, math.nan, 1.0, claims_infeasible=True))
    rows.append(row("random/c", "bonmin", 5.0, 9.0))
    rows.append(row("paper/b", OURS, 200.0, 60.0, lower_bound=150.0))
    rows.append(row("random/d", OURS, math.nan, 1.0))
    text = report.page(rows, [], [], {})
    assert text.split("\n\n")[1] == "**Where evrelax loses.**"
    first = text.split("\n\n")[2]
    for line in first.split("\n"):
        assert line.startswith(("- **", "  - ")) and len(line) < 200
    included, before = "their model building included", "if their model is built before"
    assert f"of `{FAST}`, {included}: `ipopt` in 1 of 1 case (down to 0.400" in first
    assert f"of `{FAST}`, {before}: `fatrop` in 2 of 2 cases (down to 0" in first
    proved = f"- **Time** of `{OURS}`, {included}:\n"  # paper/b is not proved
    assert proved + "  - `ipopt` in 1 of 1 case (down to 0.080 of our time)\n" in first
    assert "`ipopt` in 1 of 1 case (by up to 3.093 %, `paper/a`, once our refinement has" in first
    assert "we do not find: `bonmin` in `random/c`" in first
    assert "not reached in 2 cases: `paper/b`, `random/c`" in first
    assert f"`{OURS}` calls 1 case infeasible where there is a plan" in first
    assert "nor a proof that there is none in `random/d`" in first
    assert f"at least 5 times that of `{OURS}`: 0.08 on paper cases" in first
    won = [row("a", FAST, 10.0, 1.0), row("a", OURS, 10.0, 1.0), row("a", "ipopt", 11.0, 9.0)]
    assert "in none of these rows (1 case)" in report.page(won, [], [], {}).split("\n\n")[1]


def test_one_of_anything_is_not_plural() -> None:
    rows = [row("paper/a", FAST, 100.0, 1.0), row("paper/a", OURS, 100.0, 1.0, lower_bound=1.0)]
    rows += [row("paper/a", "ipopt", math.nan, 1.0), row("corridor/b", OURS, 50.0, 1.0)]
    text = report.page(rows, [], [], {})
    assert "2 cases: 1 variant of `paper-400km`" in text and "1 other shipped trip." in text
    assert not re.search(r"\b1 (cases|runs|variants|trips|plans|proofs|rounds)\b", text)


def test_much_memory_and_proofs_without_effect_are_losses() -> None:
    def point(n: int, asked: str, gap: float, memory: float, ended: str = "done") -> Row:
        return dict.fromkeys(scale.COLUMNS, "") | {
            "sweep": "chargers", "value": str(n), "asked_gap": asked, "gap": str(gap),
            "memory_mb": str(memory), "ended": ended, "time_limit_s": "30.0",
        }  # fmt: skip

    rows = [point(3, "", 0.04, 500.0), point(20, "", 0.08, 501.0), point(9, "", 0.05, 90.0)]
    rows += [point(3, "0.01", 0.01, 90.0), point(20, "0.01", 0.08, 1200.0, "limit")]
    rows += [point(9, "0.01", 0.04, 90.0, "limit")]
    said = losses(summarise([row("a", FAST, 1.0, 1.0)]), (), rows).split("\n")
    at = said.index("- **Memory** above 500 MB in the sweeps below:")
    assert said[at + 1 : at + 3] == [
        "  - chargers 20: 501 MB", "  - chargers 20, 1 % asked for: 1200 MB"
    ]  # fmt: skip
    assert "  - chargers 9, 1 % asked for: 4.00 % after 30 s" in said
    unmoved = "8.00 % after 30 s, no less than without a proof"
    assert f"  - chargers 20, 1 % asked for: {unmoved}" in said
    page = report.page([row("a", FAST, 1.0, 1.0)], rows, [], {})
    assert unmoved in page  # and not in the terminal only


def test_times_of_other_runs_are_held_against_these() -> None:
    rows = [row(f"paper/{name}", OURS, 100.0, 2.0) for name in "abc"]
    rows.append(row("paper/c", OURS, 100.0, 9.0, run="later"))
    proofs = [
        {"case": f"paper/{name}", "asked_gap": "0.01", "programs": programs, "total_s": "3.0",
         "workers": "1"}
        for name, programs in (("a", 3), ("b", 4), ("c", 3))
    ]  # fmt: skip
    proofs.append(proofs[0] | {"asked_gap": "0.001", "total_s": "90.0"})
    proofs.append(proofs[0] | {"workers": "2", "total_s": "1.8"})
    text = report.page(rows, [], [], {}, proofs)
    assert "The rows are of 2 runs, each under its own load" in text
    assert "has 2 proofs to 1 % with the same number of programs as here" in text  # not paper/b
    assert "0.67 to 3.00 times those there, median 1.83 (`paper/c`: 9.0 s here, 3.0 s" in text
    assert "proofs.csv" not in report.page(rows, [], [], {})


def test_whether_a_changed_judge_matters_is_said() -> None:
    rows = [row("a", FAST, 100.0, 1.0, judge="1"), row("b", FAST, 50.0, 1.0, judge="2")]
    assert "was not measured" in report.page(rows, [], [], {})
    assert "code of the judge" not in report.page(rows[:1], [], [], {})
    again = {
        "case": "a", "judge": "1", "judge_now": "3", "outcome": "holds", "outcome_now": "holds",
        "claimed_cost": "100", "claimed_now": "100", "replayed_cost": "100",
        "replayed_now": "100.00000001", "date": "2026-01-03",
    }  # fmt: skip
    other = again | {"claimed_now": "99", "replayed_now": "99"}  # another plan: says nothing
    text = report.page(rows, [], [], {}, (), [again, other])
    assert "made 1 plan anew and judged it by the judge of 2026-01-03 (`3`)" in text
    assert "no verdict changed and no cost moved by more than 1e-10" in text
    assert "No row of `2` was among them." in text
    text = report.page(rows, [], [], {}, (), [again | {"judge": "2", "replayed_now": "101"}])
    assert "costs moved by up to 1e-02" in text
    text = report.page(rows, [], [], {}, (), [again, again | {"outcome_now": "fails"}])
    assert "the verdict changed in `a`" in text


def test_plans_to_judge_again_are_spread_over_cases() -> None:
    rows = [row(f"paper/{at}", "ipopt", 100.0, 1.0, judge="1") for at in range(9)]
    rows += [row("paper/0", "fatrop", 100.0, 1.0, version="old"), row("a", "bonmin", 1.0, 99.0)]
    rows += [row("b", "bonmin", math.inf, 1.0)]
    found = list(judges.chosen(rows, {"ipopt": "1", "fatrop": "2", "bonmin": "1"}, 3))
    assert [r["case"] for r in found] == ["paper/0", "paper/3", "paper/6"]


def test_fingerprints_and_the_version_of_a_checkout_are_explained() -> None:
    text = report.page([row("a", FAST, 1.0, 1.0, versions="python=3 evrelax=not installed")],
                       [], [], {})  # fmt: skip
    assert "not installed" not in text and "run from a checkout" in text
    assert "`code=` is a fingerprint" in text and "Equal digits: equal code." in text
    installed = report.page([row("a", FAST, 1.0, 1.0, versions="evrelax=0.1.0")], [], [], {})
    assert "run from a checkout" not in installed and "with evrelax=0.1.0." in installed
    assert re.fullmatch(r"\d+\.\d+\.\d+(\+checkout)?", versions()["evrelax"])


def test_what_was_asked_for_is_held_against_the_certified_plan() -> None:
    rows = []
    for case, seconds in (("paper/a", 1.0), ("paper/b", 4.0)):
        rows += [row(case, FAST, 100.0, 0.5 * seconds), row(case, OURS, 100.0, seconds)]
        rows.append(row(case, "fatrop", 99.97, 2.0, build_s=6.0))
        rows.append(row(case, "bonmin", 101.0, 100.0, claimed_cost=90.0))
    rows.append(row("paper/c", OURS, 100.0, 9.0, lower_bound=90.0))  # no proof: no ratio
    rows.append(row("paper/c", "fatrop", 100.0, 1.0))
    rows.append(row("paper/a", "scip-our-time", 120.0, 1.0, lower_bound=80.0))
    rows.append(row("paper/b", "scip-our-time", math.nan, 4.0))
    own = {"case": "paper/a", "asked_gap": "", "ended": "done", "total_s": 5.0, "clarabel_s": 2.0}
    floor_rows = [own | {"programs": 3, "solve_s": 2.5}]
    entries = asked(summarise(rows), rows, floor_rows)
    by = {e["words"]: (e["measured"], e["reached"]) for e in entries}
    cost = next(v for k, v in by.items() if f"cost of `{OURS}`" in k)
    assert cost == ("worst of 3 cases: +0.0300 % (`paper/a`)", True)
    counted = next(v for k, v in by.items() if "`fatrop`" in k and "counted" in k)
    assert counted == (
        "4.00 (2.00 to 8.00); below in 0 of 2 cases; without an asked proof 8.00", True
    )  # fmt: skip
    before = next(v for k, v in by.items() if "`fatrop`" in k and "before" in k)
    assert before[0].startswith("1.00 (0.50 to 2.00); below in 1 of 2") and before[1]
    confirmed = by["the peers' costs confirmed by the judge"][0]
    assert confirmed == (
        "of 6 plans hold when driven: 6; of these as claimed: 4; 1 run ended without a plan"
    )
    late = by["SCIP's gap at our finishing time reported"][0]
    assert late.startswith("a plan in 1 of 2 cases, a bound above zero in 1; that bound is 20.0 %")
    assert missed(entries) == [
        "our time at most 2 times Clarabel's own: 2.50 with no gap asked for"
    ]  # bonmin takes 50 times ours
    rows[2] = row("paper/a", "fatrop", 99.9, 2.0)
    short = missed(asked(summarise(rows), rows, []))
    assert len(short) == 1 and short[0].endswith(
        f"missed by `{FAST}` in 1 of 2 cases, missed by `{OURS}` in 1 of 3 cases"
    )


def test_savings_against_drivers_by_ambient_temperature() -> None:
    rows = [row("a", FAST, 80.0, 1.0), row("b", FAST, 50.0, 1.0, ambient_c=10.0)]
    rows.append(row("a", "driver-plain", 100.0, 0.1, charging_h=0.75))
    rows.append(row("b", "driver-plain", math.nan, 0.1, ambient_c=10.0))
    cold, mild = summarise(rows)["savings"]["driver-plain"]
    assert cold["to_c"] == -5.0 and cold["cases"] == 1
    assert cold["saved_min"] == pytest.approx(15.0) and cold["saved_cost"] == pytest.approx(0.2)
    assert mild["cases"] == 0 and mild["driver_fails"] == 1 and mild["saved_cost"] is None


def test_a_refusal_is_a_row_and_no_point_of_a_fit(tmp_path: Path) -> None:
    refused = measure_plan(PlanTask(scale.make_trip("chargers", 60), None, 1.0))
    assert refused["ended"] in ("refused", "limit", "done")
    rows: list[Row] = [
        {"sweep": "chargers", "value": n, "asked_gap": "", "ended": "done", "message": "feasible",
         "total_s": 0.1 * 2.0**n, "memory_mb": 100.0, "memory_before_mb": 90.0, "programs": n,
         "cost": 1.0, "gap": 0.1, **{f"{p}_s": 0.0 for p in ("assembly", "reach", "solve")}}
        for n in (3, 6, 8)
    ]  # fmt: skip
    rows.append({"sweep": "chargers", "value": 20, "asked_gap": "", "ended": "refused",
                 "message": "at most 14"})  # fmt: skip
    (fit,) = scale.fits(rows)
    assert fit["points"] == 3 and fit["factor_per_charger"] == pytest.approx(2.0)
    assert fit["ended_otherwise"] == {"20": "refused: at most 14"}
    assert "refused: at most 14" in scale.table(rows)
    first = losses(summarise([row("a", FAST, 1.0, 1.0)]), (), rows)
    assert "**No plan** in the sweeps below: chargers 20 (refused: at most 14)" in first


def test_scatter_gets_no_exponent() -> None:
    def point(value: int, seconds: float, runs: list[float]) -> Row:
        return {
            "sweep": "cells", "value": value, "asked_gap": "", "ended": "done", "message": "",
            "total_s": seconds, "runs_s": json.dumps(runs), "memory_mb": 100.0 + value,
            "memory_before_mb": 100.0, "programs": 9, "cost": 1.0, "gap": 0.1,
        }  # fmt: skip

    noisy = zip((6, 12, 24, 48, 96), (0.72, 1.45, 1.21, 0.62, 1.55), strict=True)
    rows = [point(value, seconds, [seconds, 2.0]) for value, seconds in noisy]
    (fit,) = scale.fits(rows)
    assert abs(fit["time_exponent"]) < 2.0 * fit["time_error"]
    assert fit["memory_exponent"] == pytest.approx(1.0) and fit["memory_error"] < 1e-9
    line = scale.fits_table([fit]).split("\n")[-1]
    assert line == "| cells | none | 5 of 5 | scatter | 1.00 ± 0.00 | - |"
    assert "| 0.62 | 0.62 to 2.00 |" in scale.table(rows)
    few = [row | {"ended": "limit"} for row in rows[:3]] + rows[3:]
    assert "| 2 of 5 | - | - |" in scale.fits_table(scale.fits(few))


def test_parts_fill_the_whole_bar() -> None:
    row = {f"{part}_s": 0.1 for part in (*scale.PARTS, "rest")} | {"total_s": 1.0}
    found = scale.shares(row | {"rest_s": -1e-4})
    assert sum(found.values()) == pytest.approx(1.0) and found["rest"] == 0.0


def test_no_two_solvers_look_alike() -> None:
    looks = [tuple(charts._look(c.name).values()) for c in CONTESTANTS]
    assert len(set(looks)) == len(CONTESTANTS)
    colours = {charts._family(c.name): charts._look(c.name)["edgecolors"] for c in CONTESTANTS}
    assert len(set(colours.values())) == len(colours)  # ours share theirs with nobody


def test_ratios_of_speed_are_of_rounds_not_of_medians() -> None:
    parts = dict.fromkeys(("build_s", "solve_s", "solve_feasible_s", "judge_s"), 0.1)
    parts |= {"cost": 1.0, "solves": 1.0, "solved": 1.0}
    rounds = []
    for ours, theirs in ((1.0, 9.0), (2.0, 2.0), (4.0, 8.0)):  # ratios 9, 1, 2; medians 2 and 8
        peer = parts | {"total_s": theirs}
        rounds.append({"evrelax": {"total_s": ours, "cost": 1.0}, "ipopt": peer, "fatrop": peer})
    text = speed.table(rounds)
    assert "8000  2.00" in text and "median over the rounds of the ratio" in text
