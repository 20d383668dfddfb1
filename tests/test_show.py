"""The text says what the report says: same sums, nothing invented, nothing too long."""

from __future__ import annotations

import dataclasses
import re
from math import inf

import pytest
from trips import small_trip

from enumerate import Diagnosis, Ledger, Outcome, Result, Row, Status, format_result, plan
from enumerate.show import _name
from enumerate.table import WIDTH, printable, table
from relax.trip import Trip


@pytest.fixture(scope="module")
def trip() -> Trip:
    """Far enough that the car must stop, dear enough to wait that it pays to split the costs."""
    trip = small_trip(time_value_per_h=60.0, start_soc=0.45)
    chargers = tuple(
        dataclasses.replace(c, stop_penalty=0.7, occupancy_price_per_h=6.0, occupancy_free_h=0.01)
        for c in trip.chargers
    )
    return dataclasses.replace(trip, chargers=chargers)


@pytest.fixture(scope="module")
def result(trip: Trip) -> Result:
    found = plan(trip, prune=False)
    assert found.plan is not None and found.plan.stops
    return found


def without_plan(status: Status, rows: tuple[Row, ...], **changes: object) -> Result:
    empty = Result(
        trip="t",
        currency="EUR",
        status=status,
        cost=inf,
        transcribed_cost=inf,
        lower_bound=min(inf if r.outcome is Outcome.INFEASIBLE else r.lower_bound for r in rows),
        plan=None,
        replay=None,
        ledger=Ledger(1, rows),
        chargers=("A",),
        timings_s={"total": 1.0},
    )
    return dataclasses.replace(empty, **changes)  # type: ignore[arg-type]


def line(text: str, start: str) -> str:
    (found,) = [part for part in text.split("\n") if part.startswith(start)]
    return found


def cells(text: str, start: str) -> list[str]:
    """Return the cells after the waypoint in the stop table."""
    stops = next(block for block in text.split("\n\n") if "waypoint" in block)
    return line(stops, start + " ").removeprefix(start).split()


def numbers(text: str) -> list[float]:
    return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", text)]


def test_stop_table_repeats_the_report(trip: Trip, result: Result) -> None:
    report = result.plan
    assert report is not None
    text = format_result(result, trip)
    for stop in report.stops:
        (km, drive, arrive, depart, soc_in, soc_out, minutes, kwh, kw, t_in, t_out, cost) = cells(
            text, stop.charger
        )
        assert float(km) == pytest.approx(stop.position_km, abs=0.05)
        assert float(soc_in) == pytest.approx(100 * stop.arrive_soc, abs=0.051)
        assert float(soc_out) == pytest.approx(100 * stop.depart_soc, abs=0.051)
        assert float(minutes) == pytest.approx(60 * stop.dwell_h, abs=0.051)
        assert float(kwh) == pytest.approx(stop.grid_kwh, abs=0.0051)
        assert float(kw) == pytest.approx(stop.grid_kwh / stop.dwell_h, abs=0.051)
        assert float(t_in) == pytest.approx(stop.arrive_temperature_c, abs=0.051)
        assert float(t_out) == pytest.approx(stop.depart_temperature_c, abs=0.051)
        assert float(cost) == pytest.approx(stop.cost, abs=0.0051)
        for shown, hours in ((arrive, stop.arrive_h), (depart, stop.depart_h)):
            h, m = shown.split(":")
            assert int(h) + int(m) / 60 == pytest.approx(hours, abs=0.5 / 60 + 1e-9)
        assert re.fullmatch(r"\d+:\d\d", drive)
    start = cells(text, "start")
    assert start[0] == "0.0" and start[3] == "0:00" and float(start[5]) == 45.0
    assert start.count("-") == 8, "what the start does not have is missing, not 0"
    end = cells(text, "destination")
    assert float(end[0]) == trip.route.length_km
    assert float(end[4]) == pytest.approx(100 * report.final_soc, abs=0.051)
    assert float(end[9]) == pytest.approx(report.final_temperature_c, abs=0.051)


def test_drive_durations_add_up_to_the_driving_time(trip: Trip, result: Result) -> None:
    report = result.plan
    assert report is not None
    text = format_result(result, trip)
    names = [*(s.charger for s in report.stops), "destination"]
    shown = [cells(text, name)[1] for name in names]
    hours = sum(int(h) + int(m) / 60 for h, m in (s.split(":") for s in shown))
    assert hours == pytest.approx(report.driving_h, abs=0.5 / 60 * len(names))


def test_costs_by_cause_add_up(trip: Trip, result: Result) -> None:
    text = format_result(result, trip)
    paragraph = text[text.index("\ncost ") :].split("\n\n")[0]
    total, *parts = numbers(paragraph)
    assert len(parts) == 5
    assert total == pytest.approx(result.cost, abs=0.0051)
    assert sum(parts) == pytest.approx(total, abs=0.03)
    assert all(part > 0.0 for part in parts), "each cause has a cost in this trip"


def test_without_the_trip_the_unknown_split_is_not_invented(result: Result) -> None:
    text = format_result(result)
    paragraph = text[text.index("\ncost ") :].split("\n\n")[0]
    assert "occupancy and penalties" in paragraph and "detour time" not in paragraph
    total, energy, rest = numbers(paragraph)
    assert energy + rest == pytest.approx(total, abs=0.02)


def test_energy_uses_add_up_and_close_the_balance(trip: Trip, result: Result) -> None:
    report = result.plan
    assert report is not None
    block = next(b for b in format_result(result, trip).split("\n\n") if b.startswith("energy"))
    rows = block.split("\n")[1:]
    values = {re.split(r"\s{2,}", r.strip())[0]: numbers(r) for r in rows if r[-1].isdigit()}
    total = values.pop("in all")[0]
    grid = values.pop("of it from the grid")[0]
    battery = values.pop("of it from the battery")[0]
    assert grid == pytest.approx(report.grid_kwh, abs=0.0051)
    assert grid + battery == pytest.approx(total, abs=0.011)
    assert sum(v[0] for v in values.values()) == pytest.approx(total, abs=0.04)
    assert sum(v[1] for v in values.values()) == pytest.approx(100.0, abs=0.4)
    pack = trip.vehicle.pack
    drawn = pack.energy_kwh(trip.start_soc) - pack.energy_kwh(report.final_soc)
    assert battery == pytest.approx(float(drawn), abs=0.011)


def test_every_subset_and_every_unused_charger_is_explained(trip: Trip, result: Result) -> None:
    text = format_result(result, trip)
    block = next(b for b in text.split("\n\n") if "outcome" in b)
    rows = block.split("\n")[2 : 2 + 2 ** len(trip.chargers)]
    assert rows[0].endswith("the plan")
    assert "proved infeasible" in block and "4 choices of stops" in block
    used = {s.charger for s in result.plan.stops} if result.plan else set()
    for charger in trip.chargers:
        explained = f"  {charger.name}: " in text.partition("chargers not used")[2]
        assert explained == (charger.name not in used)


def test_lines_are_short_and_ascii_is_possible(trip: Trip, result: Result) -> None:
    named = tuple(
        dataclasses.replace(c, name=f"Göteborg Södra snabbladdning {i}")
        for i, c in enumerate_of(trip.chargers)
    )
    renamed = dataclasses.replace(trip, chargers=named)
    text = format_result(plan(renamed), renamed)
    assert max(len(row) for row in text.split("\n")) <= WIDTH
    plain = printable(text, "ascii")
    assert plain.isascii() and "Goteborg" in plain and "?" not in plain
    assert printable(text, "utf-8") == text


def enumerate_of(items: tuple[object, ...]) -> list[tuple[int, object]]:
    return list(zip(range(len(items)), items, strict=True))


def test_more_than_sixteen_subsets_are_counted(result: Result) -> None:
    names = tuple("abcde")
    subsets = [tuple(i for i in range(5) if m >> i & 1) for m in range(32)]
    rows = tuple(Row(s, Outcome.BOUNDED, lower_bound=400.0 + len(s)) for s in subsets)
    many = dataclasses.replace(
        result, ledger=Ledger(5, rows), chargers=names, plan=None, programs=0
    )
    text = format_result(many)
    assert "32 choices of stops: 32 cannot be better." in text
    block = next(b for b in text.split("\n\n") if "outcome" in b)
    listed = block.split("\n")[2:]
    assert len(listed) == 12 + 1 + 1 + len(["Costs"]) and "403.00" not in "".join(listed[:12])
    assert listed[12].split() == "20 other subsets - 402.00 cannot be better".split()


def test_hundreds_of_rows_are_summed_by_outcome(result: Result) -> None:
    subsets = [tuple(i for i in range(9) if m >> i & 1) for m in range(512)]
    outcomes = [Outcome.PLANNED] * 20 + [Outcome.UNPROVED] * 100 + [Outcome.INFEASIBLE] * 300
    outcomes += [Outcome.BOUNDED] * 92
    rows = tuple(
        Row(s, o, 500.0 + k if o is Outcome.PLANNED else inf, 400.0 + k)
        for k, s, o in zip(range(512), subsets, outcomes, strict=True)
    )
    names = tuple(f"charger {i}" for i in range(9))
    many = dataclasses.replace(
        result, ledger=Ledger(9, rows), chargers=names, plan=None, programs=1764
    )
    text = format_result(many)
    block = next(b for b in text.split("\n\n") if "outcome" in b).split("\n")
    assert len(block) < 24
    summed = [re.split(r"\s{2,}", row) for row in block if "other subsets" in row]
    assert summed == [
        ["8 other subsets", "512.00", "412.00", "planned"],
        ["92 other subsets", "-", "820.00", "cannot be better"],
        ["300 other subsets", "-", "520.00", "proved infeasible"],
        ["100 other subsets", "-", "420.00", "not settled"],
    ]
    assert "Solved for it: 1764 programs for 512 subsets." in block


@pytest.mark.parametrize(
    ("row", "name"),
    [
        (Row((1,), Outcome.BOUNDED), "b"),
        (Row((), Outcome.BOUNDED), "no stop"),
        (
            Row((1,), Outcome.BOUNDED, undecided=(0, 2, 3, 4, 5), count=(0, 6)),
            "b + any of 5 others (32 subsets)",
        ),
        (
            Row((1, 2), Outcome.BOUNDED, undecided=(0, 3, 4), count=(3, 3)),
            "b + c + 1 of 3 others (3 subsets)",
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 2, 3, 4, 5), count=(3, 6)),
            "at least 3 of 6 chargers (42 subsets)",
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 2, 3), count=(0, 2)),
            "up to 2 of 4 chargers (11 subsets)",
        ),
        (
            Row((5,), Outcome.BOUNDED, undecided=(0, 1, 2, 3), count=(2, 3)),
            "f + 1 to 2 of 4 others (10 subsets)",
        ),
        (Row((5,), Outcome.BOUNDED, undecided=(0, 1), count=(1, 3)), "f + any of a, b (4 subsets)"),
        (Row((5,), Outcome.BOUNDED, undecided=(0, 1), count=(3, 3)), "a + b + f"),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 4), count=(1, 1), without=((0,),)),
            "1 of 3 chargers (2 subsets, those listed apart left out)",
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 4), count=(1, 1), without=((0,), (4,))),
            "b",
        ),
        (Row((), Outcome.BOUNDED, undecided=(0, 1), count=(0, 0)), "no stop"),
    ],
)
def test_a_family_is_named_by_what_it_holds(result: Result, row: Row, name: str) -> None:
    assert _name(dataclasses.replace(result, chargers=tuple("abcdef")), row) == name


def test_a_family_is_never_taken_for_the_plan(result: Result) -> None:
    """A plan without stops and a family without decided stops both have an empty subset."""
    plan_ = result.plan
    assert plan_ is not None
    rows = (
        Row((), Outcome.BOUNDED, inf, 95.0, undecided=(0, 1), count=(1, 2)),
        Row((), Outcome.PLANNED, 100.0, 99.0),
    )
    bare = dataclasses.replace(
        result, cost=100.0, lower_bound=95.0, ledger=Ledger(2, rows),
        plan=dataclasses.replace(plan_, stops=(), charge=()),
    )  # fmt: skip
    text = format_result(bare)
    assert line(text, "no stop").endswith("the plan")
    assert "at least 1 of" in text and "cannot be better by more than 5.00 %" in text
    assert "no plan with it is better by more than 5.00 %" in text


def test_infeasible_gives_reason_and_remedies() -> None:
    rows = tuple(Row(s, Outcome.INFEASIBLE, lower_bound=inf) for s in ((), (0,)))
    diagnosis = Diagnosis(80.0, 4.0, "the car gets to 80.0 km", ("start.soc of about 0.70",))
    text = format_result(without_plan(Status.INFEASIBLE, rows, diagnosis=diagnosis))
    assert "no plan" in text and "the car gets to 80.0 km." in text
    assert "- start.soc of about 0.70" in text
    assert "inf " not in text and "none is known" not in text


def test_unknown_does_not_claim_anything() -> None:
    rows = (Row((), Outcome.INFEASIBLE, lower_bound=inf), Row((0,), Outcome.UNPROVED))
    text = format_result(without_plan(Status.UNKNOWN, rows, interrupted="time limit reached"))
    assert "time limit reached" in text and "none is ruled out" in text
    assert "bound   none is known." in text
    assert line(text, "A ").split()[1:3] == ["-", "-"]


def test_a_long_word_column_wraps_and_keeps_its_place() -> None:
    text = table(["a", "b", "why"], [["x" * 30, "1", "word " * 40], ["y", "2", "short"]], True)
    rows = text.split("\n")
    assert max(len(r) for r in rows) <= WIDTH and len(rows) > 4
    assert len({r.index("word") for r in rows if "word" in r}) == 1
