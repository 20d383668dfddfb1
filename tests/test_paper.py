"""The paper's experiments: published figures, fit, kept rows, verdicts, and what the cases do."""

from __future__ import annotations

import doctest
import importlib
import json
from concurrent.futures import BrokenExecutor, Executor, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import cache
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.data import paper
from benchmarks.data.paper import FIT, FIT_FILE, NAMES, RANGES, overrides, read_fit
from benchmarks.paper import calibrate, claims, fit, tables
from benchmarks.paper.__main__ import write
from benchmarks.paper.cases import (
    OFF_KW,
    Behaviour,
    Found,
    all_found,
    behaviour,
    case_trip,
    published_plan,
)
from benchmarks.paper.fronts import At, energy_at, least_energy, least_time, runner_up
from benchmarks.paper.kept import report_from, report_to
from benchmarks.paper.published import (
    AMBIENT_C,
    CASES,
    ENERGY_KWH,
    HEAT_PUMP_KW,
    LEAST_TIME_MIN,
    PRINTED_SAVING,
    saving,
)
from benchmarks.paper.run import Rows, kept, run
from benchmarks.paper.sweep import points, switches
from benchmarks.paper.trips import paper_trip
from relax import load_trip
from relax.report import PlanReport

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "paper.jsonl"
MODULES = ("__main__", "calibrate", "cases", "claims", "figures", "fit", "fronts", "kept", "page",
           "published", "run", "sweep", "tables", "trips", "values")  # fmt: skip


@cache
def case_plan(name: str) -> PlanReport:
    case = next(c for c in CASES if c.name == name)
    return published_plan(case_trip(case), case.stops)


def did(name: str) -> Behaviour:
    return behaviour(case_plan(name), load_trip("paper-400km").vehicle.heater_kw)


class TestPublished:
    def test_savings_are_those_the_paper_prints(self) -> None:
        """Within the rounding of the values, but for the energy at 10 C."""
        for (t, p), printed in PRINTED_SAVING["energy"].items():
            follows = saving(ENERGY_KWH, t, p)
            assert (abs(follows - printed) < 0.2) == (t != 10.0)
            assert t != 10.0 or follows == pytest.approx(20.4, abs=0.05)
        for (t, p), printed in PRINTED_SAVING["time"].items():
            assert saving(LEAST_TIME_MIN, t, p) == pytest.approx(printed, abs=0.2)

    def test_both_tables_are_complete(self) -> None:
        wanted = {(t, p) for t in AMBIENT_C for p in HEAT_PUMP_KW}
        assert set(ENERGY_KWH) == wanted == set(LEAST_TIME_MIN)

    @pytest.mark.parametrize("module", MODULES)
    def test_examples_run(self, module: str) -> None:
        assert doctest.testmod(importlib.import_module(f"benchmarks.paper.{module}")).failed == 0


class TestFit:
    def test_every_number_is_within_its_range_and_says_what_it_is(self) -> None:
        assert tuple(RANGES) == NAMES
        for name in NAMES:
            r = RANGES[name]
            assert r.low < r.likely < r.high and r.low <= getattr(FIT, name) <= r.high
            assert len(r.meaning) > 10

    def test_the_file_holds_errors_and_shares(self) -> None:
        lines = [x for x in FIT_FILE.read_text("utf-8").splitlines() if not x.startswith("#")]
        assert lines[0] == "name,value,standard_error,share"
        for line in lines[1:]:
            name, _, error, share = line.split(",")
            assert 0.0 < float(error) <= RANGES[name].deviation * 1.01
            assert 0.0 <= float(share) <= 1.0

    def test_overrides_of_the_shipped_fit_are_the_shipped_car(self) -> None:
        shipped, made = load_trip("paper-400km"), load_trip("paper-400km", dict(overrides(FIT)))
        assert np.array_equal(shipped.route.propulsion_kw, made.route.propulsion_kw)
        assert np.array_equal(shipped.route.drivetrain_heat_kw, made.route.drivetrain_heat_kw)
        energy = shipped.vehicle.pack.energy_kwh(np.linspace(0.1, 0.9, 9))
        for t in (-10.0, 5.0, 25.0):
            both = [car.vehicle.pack.charge_limit_kw(energy, t) for car in (shipped, made)]
            assert np.array_equal(*both)
            assert shipped.vehicle.pack.resistance_ohm(t) == made.vehicle.pack.resistance_ohm(t)
            assert shipped.vehicle.heat_pump_cop(t) == made.vehicle.heat_pump_cop(t)

    @pytest.mark.parametrize("name", NAMES)
    def test_every_number_changes_the_car(self, name: str) -> None:
        r = RANGES[name]
        other = replace(FIT, **{name: r.low if getattr(FIT, name) > r.likely else r.high})
        assert json.dumps(overrides(other)) != json.dumps(overrides(FIT))

    def test_fit_file_is_written_and_read_back(self, tmp_path: Path) -> None:
        n = len(NAMES)
        report = fit.Report(np.ones(n), np.eye(n), np.full(n, 0.1), np.full(n, 0.5))
        file = tmp_path / "fit.csv"
        file.write_text(calibrate.fit_text(FIT, report), encoding="utf-8")
        assert read_fit(file) == FIT

    def test_preset_text_follows_the_fit(self) -> None:
        warm = replace(FIT, resistance_25_mohm=50.0)
        _, fields = paper.paper_2022(warm)
        field = next(f for f in fields if f.key == "resistance_ohm")
        assert "0.05 ohm" in field.origin
        assert dict(field.value)[25.0] == pytest.approx(0.05)  # type: ignore[arg-type]

    def test_a_step_recovers_what_made_the_figures(self) -> None:
        """Values that are linear in the numbers: one unbounded step fits them up to the guess."""
        random = np.random.default_rng(3)
        n = len(NAMES)
        truth = random.normal(0.0, 0.5, n)
        model_values, slopes = {}, {}
        for key, published in fit.ROWS:
            slope = 20.0 * random.normal(size=n)
            slopes[key, (1,)] = slope
            model_values[key, (1,)] = published - float(slope @ truth)
        found = fit.step(fit.Linear(model_values, slopes), np.zeros(n), inf)
        assert np.allclose(found, truth, atol=0.02)

    def test_a_step_keeps_ranges_and_length(self) -> None:
        n = len(NAMES)
        slopes = {(key, (1,)): np.full(n, 30.0) for key, _ in fit.ROWS}
        far = {(key, (1,)): published - 1e4 for key, published in fit.ROWS}
        model = fit.Linear(far, slopes)
        assert np.allclose(fit.step(model, np.zeros(n), 0.3), 0.3)
        high = np.array([(r.high - r.likely) / r.deviation for r in RANGES.values()])
        assert np.allclose(fit.step(model, high - 0.1, 1.0), 0.1)

    def test_the_least_of_two_choices_of_stops_is_fitted(self) -> None:
        """A choice that is worse now is taken if it fits better after the step."""
        n = len(NAMES)
        key, published = fit.ROWS[0]
        rest = {(k, (1,)): v for k, v in fit.ROWS}
        flat = {(k, (1,)): np.zeros(n) for k, _ in fit.ROWS}
        unit = np.eye(n)[0]
        model = fit.Linear(
            rest | {(key, (1,)): published + 0.5, (key, (1, 2)): published + 0.6},
            flat | {(key, (1, 2)): -unit},
        )
        found = fit.step(model, np.zeros(n), 1.0)
        assert found[0] == pytest.approx(0.6, abs=0.02)

    @pytest.mark.long
    def test_the_shipped_car_meets_the_tables(self) -> None:
        from benchmarks.paper.values import Car, values

        base, _ = values(Car(None), {})
        for key, published, ours in fit.deviations(base):
            assert ours == pytest.approx(published, **(
                {"rel": 0.01} if key[0] == "energy" else {"abs": 0.2}
            )), key  # fmt: skip


def front(value: float, minutes: float, stops: tuple[int, ...] = (1,)) -> dict[str, Any]:
    """Row of a front with three points around the given one."""

    def point(t: float, v: float) -> dict[str, Any]:
        return {"time_h": t / 60.0, "budget_h": t / 60.0, "value": v, "lower_bound": 0.99 * v,
                "least_time_h": 0.98 * t / 60.0, "subset": list(stops)}  # fmt: skip

    times = (minutes - 1.0, minutes, minutes + 5.0)
    return {
        "points": [point(t, v) for t, v in zip(times, (value + 2.0, value, value - 0.5),
                                               strict=True)],
        "curves": [],
    }  # fmt: skip


class TestTables:
    def test_values_are_read_within_the_published_time(self) -> None:
        row = front(31.0, 28.0)
        at = energy_at(row, -10.0)
        assert at.value == 31.0 and at.at_min == pytest.approx(28.0)
        assert at.gap == pytest.approx(0.01)
        assert least_time(row).value == pytest.approx(27.0)
        assert least_time(row).gap == pytest.approx(0.02)
        assert least_energy(row).value == 30.5

    def test_beyond_the_published_time_it_is_read_just_above_the_least(self) -> None:
        row = front(31.0, 22.45)
        row["points"][0]["time_h"] = 22.4 / 60.0
        at = energy_at(row, 0.0)
        assert at.value == 31.0 and at.at_min == pytest.approx(22.45)

    def test_published_values_meet_the_goals_and_others_do_not(self) -> None:
        def made(extra: float) -> list[tables.Cell]:
            found = []
            for name, table in (("energy", ENERGY_KWH), ("time", LEAST_TIME_MIN)):
                for (t, p), value in table.items():
                    at = At(value + extra, 0.99 * value, 20.0, (1,))
                    same = saving(table, t, p)
                    found.append(tables.Cell(name, t, p, value, at, same, same))
            return found

        assert tables.goals_met(made(0.0))
        assert not tables.goals_met(made(0.25))
        assert not tables.goals_met(made(0.0)[:-1])
        text = tables.markdown(made(0.25), "time")
        assert text.count("+0.25 min") == 9 and "38.4" not in text

    def test_a_saving_that_is_off_is_not_met(self) -> None:
        cell = tables.Cell("energy", 0.0, 1.0, 25.2, At(25.2, 25.0, 22.0, (2,)), 19.4, 20.5)
        assert not cell.met and replace(cell, saving=19.9).met

    def test_savings_of_the_cells_are_against_no_heat_pump(self) -> None:
        fronts = {(-10.0, 0.0): front(40.0, 28.0), (-10.0, 1.0): front(30.0, 28.0)}
        found = [c for c in tables.cells(fronts) if c.table == "energy"]
        assert [c.saving for c in found] == [0.0, pytest.approx(25.0)]


class TestCases:
    def test_margin_and_verdict(self) -> None:
        case = CASES[0]
        at = At(38.0, 37.9, inf, (1, 2))
        found = Found(case, at, (1,), -0.3, case_plan("A"))
        assert found.verdict == "as published"
        assert replace(found, margin=0.3).verdict == "not as published"
        assert replace(found, margin=-0.09).verdict == "tie" == replace(found, margin=0.09).verdict
        assert runner_up({(1, 2): 3.0}, (1, 2)) == ((), inf)

    def test_case_d_reads_its_own_row(self) -> None:
        case = next(c for c in CASES if c.name == "D")
        own = {
            "published": report_to(case_plan("A")),
            "unheated_kwh": 0.0,
            "value": 310.0,
            "lower_bound": 307.0,
            "stops": [1],
            "costs": [[[1], 309.9], [[1, 2], 315.0], [[0], None]],
        }
        found = all_found({}, {"D": own})
        assert [f.case for f in found] == [case]
        assert found[0].other == (1, 2) and found[0].margin == pytest.approx(-5.1)

    def test_a_plan_is_kept_and_read_back(self) -> None:
        report = case_plan("A")
        back = report_from(json.loads(json.dumps(report_to(report))))
        assert back.stops[0].charger == report.stops[0].charger
        assert np.allclose(back.drive.temperature_c, report.drive.temperature_c, rtol=1e-6)
        assert np.allclose(back.charge[1].grid_kw, report.charge[1].grid_kw, rtol=1e-6)
        kept = report_to(report)
        del kept["drive"]["soc"]
        with pytest.raises(TypeError, match="soc"):
            report_from(kept)

    def test_published_stops_are_used(self) -> None:
        for case in CASES[:3]:
            names = [c.name for c in case_trip(case).chargers]
            used = tuple(names.index(s.charger) for s in case_plan(case.name).stops)
            assert used == case.stops

    def test_a_does_not_heat_and_ends_warm(self) -> None:
        b = did("A")
        assert b.heating_kwh < 0.01
        assert 25.0 < b.final_c < 30.0

    def test_c_heats_before_and_in_the_stop_though_it_minimises_energy(self) -> None:
        b = did("C")
        assert b.heating_before_kwh > 0.5 and b.heating_at_stops_kwh > 0.1
        assert b.pump_before_kw[0] < OFF_KW < b.pump_else_kw[0]
        assert b.final_c < 0.0
        trace = case_plan("C").charge[0]
        heating = trace.battery_heater_kw > 0.1
        assert heating[0] and not heating[6:].any(), "in its first minutes only"

    def test_b_switches_the_heat_pump_off_for_the_stops(self) -> None:
        b = did("B")
        assert all(p < OFF_KW for p in b.pump_first_kw)
        assert b.heating_before_kwh < 0.01

    def test_e_preheats_and_heats_while_charging(self) -> None:
        b = did("E")
        assert b.heating_before_kwh > 1.0
        assert all(abs(t - 25.0) < 5.0 for t in b.arrive_c)
        assert min(b.heater_full) > 0.5
        assert b.pump_at_stops_kwh > 0.05
        assert b.heating_kwh > did("B").heating_kwh + 2.0


class TestClaims:
    def test_verdicts_follow_the_figures(self) -> None:
        at = At(34.0, 33.8, inf, (1, 2))
        found = [Found(CASES[0], at, (1,), m, case_plan("A")) for m in (-0.5, 0.05, 0.5)]
        told = [claims.verdicts([], [f]) for f in found]
        assert [t[0].verdict for t in told] == ["confirmed", "open", "not confirmed"]
        assert all(v.verdict == "confirmed" for v in told[0][1:])
        cold = replace(case_plan("A"), final_temperature_c=12.0)
        wrong = claims.verdicts([], [replace(found[0], report=cold)])
        assert "not confirmed" in [v.verdict for v in wrong]

    def test_a_little_heating_that_gains_nothing_is_a_tie(self) -> None:
        at = At(34.0, 33.8, inf, (1, 2))
        found = Found(CASES[1], at, (1,), -0.5, case_plan("E"))
        told = [
            {v.statement: v.verdict for v in claims.verdicts([], [replace(found, unheated_kwh=u)])}
            for u in (0.02, 0.5)
        ]
        assert [t["case B: no battery heating"] for t in told] == ["open", "not confirmed"]

    def test_what_the_paper_prints_against_its_own_values_is_said(self) -> None:
        fronts = {(t, p): front(30.0 - p, 28.0) for t in AMBIENT_C for p in HEAT_PUMP_KW}
        told = {v.statement: v for v in claims.verdicts(tables.cells(fronts), [])}
        verdict = told["charged energies: 18.4 % saved at 10 °C, 1 kW"]
        assert verdict.verdict == "not confirmed" and "20.4 %" in verdict.why
        assert not any("19.4 % saved" in s for s in told)

    def test_preheating_in_case_c_contradicts_the_statement(self) -> None:
        case = next(c for c in CASES if c.name == "C")
        found = Found(case, At(32.6, 32.4, inf, (1,)), (1, 2), -0.2, case_plan("C"))
        by = {v.statement: v.verdict for v in claims.verdicts([], [found])}
        assert by["preheating appears only where time is minimised"] == "not confirmed"


class TestSweep:
    def test_savings_and_switches(self) -> None:
        def row(kwh: float, *stops: str) -> dict[str, Any]:
            return {"grid_kwh": kwh, "minutes": 20.0, "stops": list(stops), "gap": 0.01}

        rows = {
            (-1.0, 0.0): row(30.0, "a", "b"),
            (0.0, 0.0): row(28.0, "b"),
            (0.0, 1.0): row(21.0, "b"),
            (1.0, 1.0): {"grid_kwh": None},
        }
        found = points(rows)
        assert [p.saving for p in found] == [None, None, pytest.approx(25.0)]
        assert switches(found, 0.0) == [(-0.5, "a + b", "b")] and switches(found, 1.0) == []


class TestRun:
    def test_all_tasks_are_asked_for(self, tmp_path: Path) -> None:
        rows = kept(tmp_path / "none.jsonl")
        assert rows.missing == 9 + 5 + 3 * 37 and rows.count == rows.computed == 0
        assert kept(tmp_path / "none.jsonl", few=True).missing == 9 + 5 + 3 * 7

    def test_cases_are_kept_and_not_computed_again(self, tmp_path: Path) -> None:
        file = tmp_path / "rows.jsonl"
        with ThreadPoolExecutor(1) as here:
            first = run(file, ["cases"], executor=Only(here, 2))
        assert set(first.cases) == {"A", "B"} and first.missing == 3 and first.interrupted
        again = kept(file)
        assert again.computed == 0 and set(again.cases) == {"A", "B"}
        assert report_from(again.cases["A"]["published"]).stops[0].charger == "km 200"


class Only(Executor):
    """Takes so many tasks and then is lost, as a killed worker is."""

    def __init__(self, inner: Executor, count: int) -> None:
        self.inner, self.left = inner, count

    def submit(self, *args: Any, **kwargs: Any) -> Any:
        self.left -= 1
        if self.left < 0:
            raise BrokenExecutor
        return self.inner.submit(*args, **kwargs)


class TestPage:
    @pytest.mark.parametrize("real", [False, pytest.param(True, marks=pytest.mark.long)])
    def test_page_and_figures_of_made_up_rows(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, real: bool
    ) -> None:
        drawn: list[tuple[str, int]] = []
        rows = Rows({(t, p): front(30.0 - p, 28.0) for t in AMBIENT_C for p in HEAT_PUMP_KW})
        rows.cases["D"] = {
            "published": report_to(case_plan("A")), "unheated_kwh": 0.0, "value": 310.0,
            "lower_bound": 307.0, "stops": [1], "costs": [[[1], 309.9], [[1, 2], 315.0]],
        }  # fmt: skip
        point = {"grid_kwh": 31.0, "minutes": 20.0, "stops": ["km 200"], "gap": 0.01}
        rows.points[0.0, 0.0] = point
        if not real:  # drawing is most of the time
            monkeypatch.setattr(
                "benchmarks.paper.__main__.save",
                lambda figure, folder, stem: drawn.append((stem, len(figure.axes))),
            )
        write(rows, tmp_path, None, 2)
        text = (tmp_path / "paper.md").read_text(encoding="utf-8")
        assert "| -10 °C | off | 28.0 min | 38.4 kWh | 30.00 kWh | -8.40 kWh (-21.9 %)" in text
        assert "Not all of them are within them. Outside: energy, -10 °C, no heat pump" in text
        stems = ("paper-front", "paper-case-D", "paper-sweep")
        if not real:
            assert drawn == [(stems[0], 3), (stems[1], 15), (stems[2], 3)]
            return
        made = {f.name for f in (tmp_path / "figures").iterdir()}
        assert made == {f"{s}.{e}" for s in stems for e in ("png", "svg")}

    @pytest.mark.long
    @pytest.mark.skipif(not RESULTS.is_file(), reason="nothing kept yet")
    def test_the_page_is_that_of_the_kept_rows(self, tmp_path: Path) -> None:
        rows = kept(RESULTS)
        assert not rows.missing, "made with another car: run python -m benchmarks.paper"
        write(rows, tmp_path, None, 2)
        now = (tmp_path / "paper.md").read_text(encoding="utf-8").splitlines()
        said = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8").splitlines()
        tables_now = [x for x in now if x.startswith("|")]
        assert tables_now == [x for x in said if x.startswith("|")]


def test_trips_are_the_papers() -> None:
    trip = paper_trip(0.0, 3.0, 40.0, stop_time_h=0.5)
    assert trip.stop_time_h == 0.5 and trip.start_temperature_c == 0.0
    other = paper_trip(0.0, 3.0, fit=replace(FIT, propulsion_factor=1.0))
    ratio = other.route.propulsion_kw / trip.route.propulsion_kw
    assert np.allclose(ratio[np.isfinite(ratio)], 1.0 / FIT.propulsion_factor)
    assert asdict(FIT).keys() == set(NAMES)
