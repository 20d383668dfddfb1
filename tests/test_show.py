"""The text says what the report says: same sums, nothing invented, nothing too long."""

from __future__ import annotations

import dataclasses
import re
from math import inf

import pytest
from trips import small_trip

from enumerate import (
    Diagnosis,
    Front,
    FrontPoint,
    Ledger,
    Outcome,
    Result,
    Row,
    Status,
    format_result,
    plan,
)
from enumerate.audit import Audit
from enumerate.ledger import REFUSED
from enumerate.show_choices import _name, format_choices
from enumerate.show_front import format_front
from enumerate.table import NO_BREAK, WIDTH, counted, paragraph, printable, table, unbroken
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


def cells(text: str, head: str, start: str) -> list[str]:
    """Return the cells after the first one of a row, in the table of this heading."""
    block = next(block for block in text.split("\n\n") if re.search(f"^{head} ", block, re.M))
    return line(block, start + " ").removeprefix(start).split()


def numbers(text: str) -> list[float]:
    return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", text)]


def test_stop_table_repeats_the_report(trip: Trip, result: Result) -> None:
    report = result.plan
    assert report is not None
    text = format_result(result, trip)
    for stop in report.stops:
        (km, drive, arrive, depart, soc_in, soc_out, t_in, t_out) = cells(
            text, "waypoint", stop.charger
        )
        assert float(km) == pytest.approx(stop.position_km, abs=0.05)
        assert float(soc_in) == pytest.approx(100 * stop.arrive_soc, abs=0.051)
        assert float(soc_out) == pytest.approx(100 * stop.depart_soc, abs=0.051)
        assert float(t_in) == pytest.approx(stop.arrive_temperature_c, abs=0.051)
        assert float(t_out) == pytest.approx(stop.depart_temperature_c, abs=0.051)
        for shown, hours in ((arrive, stop.arrive_h), (depart, stop.depart_h)):
            h, m = shown.split(":")
            assert int(h) + int(m) / 60 == pytest.approx(hours, abs=0.5 / 60 + 1e-9)
        assert re.fullmatch(r"\d+:\d\d", drive)
        (minutes, detour, kwh, kw, energy, cost) = cells(text, "stop", stop.charger)
        assert float(minutes) == pytest.approx(60 * stop.dwell_h, abs=0.051)
        assert float(detour) == pytest.approx(60 * stop.detour_h, abs=0.051)
        assert float(kwh) == pytest.approx(stop.grid_kwh, abs=0.0051)
        assert float(kw) == pytest.approx(stop.grid_kwh / stop.dwell_h, abs=0.051)
        assert float(energy) == pytest.approx(stop.energy_cost, abs=0.0051)
        assert float(cost) == pytest.approx(stop.cost, abs=0.0051)
    start = cells(text, "waypoint", "start")
    assert start[0] == "0.0" and start[3] == "0:00" and float(start[5]) == 45.0
    assert start.count("-") == 4, "what the start does not have is missing, not 0"
    end = cells(text, "waypoint", "destination")
    assert float(end[0]) == trip.route.length_km
    assert float(end[4]) == pytest.approx(100 * report.final_soc, abs=0.051)
    assert float(end[6]) == pytest.approx(report.final_temperature_c, abs=0.051)


def test_several_stops_are_summed(trip: Trip, result: Result) -> None:
    report = result.plan
    assert report is not None and len(report.stops) == 1
    assert "in all" not in format_result(result, trip).split("\n\n")[3]
    twice = dataclasses.replace(
        report,
        stops=report.stops * 2,
        charge=report.charge * 2,
        grid_kwh=2 * report.grid_kwh,
        charging_h=2 * report.charging_h,
        detour_h=2 * report.detour_h,
    )
    text = format_result(dataclasses.replace(result, plan=twice), trip)
    block = next(b for b in text.split("\n\n") if re.search("^stop ", b, re.M))
    *_, one, sums = [numbers(row.partition("  ")[2]) for row in block.split("\n")]
    for k in (0, 1, 2, 4, 5):
        assert sums[k] == pytest.approx(2 * one[k], abs=0.11)
    assert sums[3] == pytest.approx(one[3], abs=0.11)  # the mean power


def test_drive_durations_add_up_to_the_driving_time(trip: Trip, result: Result) -> None:
    report = result.plan
    assert report is not None
    text = format_result(result, trip)
    names = [*(s.charger for s in report.stops), "destination"]
    shown = [cells(text, "waypoint", name)[1] for name in names]
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
    assert "occupancy and penalties" in " ".join(paragraph.split())
    assert "detour time" not in paragraph
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
        explained = f"\n{charger.name} " in text.partition("\nnot used ")[2]
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
    assert "\n32 choices of stops: 32 cannot be better.\n" in text
    block = next(b for b in text.split("\n\n") if "outcome" in b)
    listed = block.split("\n")[2:]
    assert len(listed) == 12 + 1 + 1 + len(["Costs"]) and "403.00" not in "".join(listed[:12])
    assert listed[12].split() == "20 other choices - 402.00 cannot be better".split()


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
    assert len(block) < 26
    summed = [re.split(r"\s{2,}", row) for row in block if "other choices" in row]
    assert summed == [
        ["8 other choices", "512.00", "412.00", "planned"],
        ["92 other choices", "-", "820.00", "cannot be better"],
        ["300 other choices", "-", "520.00", "proved infeasible"],
        ["100 other choices", "-", "420.00", "not settled"],
    ]
    assert "1764 programs were solved for it." in block


@pytest.mark.parametrize(
    ("row", "name"),
    [
        (Row((1,), Outcome.BOUNDED), "b"),
        (Row((), Outcome.BOUNDED), "no stop"),
        (
            Row((1,), Outcome.BOUNDED, undecided=(0, 2, 3, 4, 5), count=(0, 6)),
            "b + any of 5 others (32 choices)",
        ),
        (
            Row((1, 2), Outcome.BOUNDED, undecided=(0, 3, 4), count=(3, 3)),
            "b + c + 1 of 3 others, without f (3 choices)",
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 2, 3, 4, 5), count=(3, 6)),
            "at least 3 of 6 chargers (42 choices)",
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 2, 3), count=(0, 2)),
            "up to 2 of 4 chargers, without e, f (11 choices)",
        ),
        (
            Row((5,), Outcome.BOUNDED, undecided=(0, 1, 2, 3), count=(2, 3)),
            "f + 1 to 2 of 4 others, without e (10 choices)",
        ),
        (Row((5,), Outcome.BOUNDED, undecided=(0, 1), count=(1, 3)), "f + any of a, b (4 choices)"),
        (Row((5,), Outcome.BOUNDED, undecided=(0, 1), count=(3, 3)), "a + b + f"),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 4), count=(1, 1), without=((0,),)),
            "1 of 3 chargers, without c, d, f (the other 2 choices)",
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1, 4), count=(1, 1), without=((0,), (4,))),
            "b",
        ),
        (Row((), Outcome.BOUNDED, undecided=(0, 1), count=(0, 0)), "no stop"),
    ],
)
def test_a_family_is_named_by_what_it_holds(result: Result, row: Row, name: str) -> None:
    found = _name(dataclasses.replace(result, chargers=tuple("abcdef")), row)
    assert found.replace(NO_BREAK, " ") == name


@pytest.mark.parametrize(
    ("subset", "name"),
    [
        ((0, 1, 2), "a town + b + c"),  # the plan
        ((0, 1, 2, 3), "plan + d"),
        ((1, 2), "plan - a town"),
        ((0, 2, 3), "plan - b + d"),
        ((0, 3), "a town + d"),
        ((2, 3), "c + d"),
        ((), "no stop"),
    ],
)
def test_beside_a_plan_of_many_stops_choices_are_named_by_their_changes(
    result: Result, subset: tuple[int, ...], name: str
) -> None:
    named = dataclasses.replace(result, chargers=("a town", "b", "c", "d"))
    best = Row((0, 1, 2), Outcome.PLANNED, 100.0, 99.0)
    found = _name(named, Row(subset, Outcome.PLANNED, 101.0, 99.0), best)
    assert found.replace(NO_BREAK, " ") == name
    few = _name(named, Row((0, 1), Outcome.PLANNED), Row((0,), Outcome.PLANNED, 100.0, 99.0))
    assert few.replace(NO_BREAK, " ") == "a town + b", "a plan of few stops is no reference"


def test_lines_break_between_names() -> None:
    text = paragraph("", "stops: " + ", ".join([unbroken("km 12 rest area")] * 9), 0)
    assert NO_BREAK not in text and max(map(len, text.split("\n"))) <= WIDTH
    assert all(row.rstrip(",").endswith("rest area") for row in text.split("\n"))
    long = unbroken("word " * 30)
    assert max(map(len, paragraph("", long, 0).split("\n"))) <= WIDTH
    rows = table(
        ["stops", "why"], [[f" +{NO_BREAK}".join(["km 12 rest area"] * 4), "x " * 40]], True
    )
    assert max(map(len, rows.split("\n"))) <= WIDTH and NO_BREAK not in rows


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
    family = re.split(r"\s{2,}", line(text, "at least 1 of"))
    assert family[1:] == ["-", "95.00", "5.00", "cannot save more"]
    assert "4 choices of stops: 1 planned, 3 cannot save more than 5.00 %.\n" in text
    assert text.count("at best 5.00 % less: proved") == 2


def test_what_is_cheaper_on_the_grid_alone_says_so(result: Result) -> None:
    best = min(result.ledger.rows, key=lambda row: row.cost)
    other = next(row for row in result.ledger.rows if row is not best and row.subset)
    cost, bound = best.cost - 1.25, best.lower_bound
    cheaper = Row(other.subset, Outcome.PLANNED, cost, bound)
    rows = tuple(cheaper if row is other else row for row in result.ledger.rows)
    ledger = dataclasses.replace(result.ledger, rows=rows)
    text = " ".join(format_result(dataclasses.replace(result, ledger=ledger)).split())
    assert "costs 1.25 less on the grid" in text and "-1.25" not in text
    assert f"the best found 1.25 {result.currency} less on the grid" in text
    assert "the ones driven cost more" in text
    assert "less on the grid" not in " ".join(format_result(result).split())


def test_what_cannot_be_better_is_counted_apart_from_what_nearly_cannot(result: Result) -> None:
    rows = (
        Row((0,), Outcome.PLANNED, 100.0, 99.5),
        Row((), Outcome.BOUNDED, inf, 100.0),
        Row((1,), Outcome.BOUNDED, inf, 99.2),
        Row((2,), Outcome.BOUNDED, inf, 130.0),
        Row((0, 1), Outcome.BOUNDED, inf, 99.7, undecided=(2,)),
        Row((0, 2), Outcome.INFEASIBLE, inf, inf),
        Row((1, 2), Outcome.UNPROVED, inf, 97.0),
    )
    assert result.plan is not None
    names = (*(s.charger for s in result.plan.stops), "b", "c")
    found = dataclasses.replace(
        result, cost=100.0, lower_bound=97.0, ledger=Ledger(3, rows), chargers=names
    )
    text = " ".join(format_choices(found).split())
    assert (
        "8 choices of stops: 1 planned, 2 cannot be better, 3 cannot save more than 0.80 %, "
        "1 proved infeasible, 1 not settled." in text
    )
    few = dataclasses.replace(result, ledger=Ledger(0, (Row((), Outcome.UNPROVED),)), programs=1)
    said = format_choices(dataclasses.replace(few, plan=None)).split("\n")
    assert "1 choice of stops: 1 not settled." in said and "1 program was solved for it." in said
    assert "could" not in " ".join(said), "without a plan there is nothing to save on"


def test_counts_have_their_noun_in_the_right_number() -> None:
    assert counted(1, "choice") == "1 choice" and counted(0, "choice") == "0 choices"
    nothing = Audit("t", "EUR", ("rows: wrong",), 1, 1, 1, 1, 2.0, 1.0, 1.0, 1)
    text = " ".join(str(nothing).split())
    assert "1 claim fails." in text
    assert "1 choice of stops in 1 row, 1 box rebuilt, 1 step over stages, 1 program" in text
    several = dataclasses.replace(nothing, failures=("a", "b"), subsets=2, rows=2, nodes=2)
    assert "2 claims fail." in str(several) and "2 choices of stops in 2 rows, 2 boxes" in str(
        several
    )


def test_a_front_is_narrow_and_tells_its_points_apart(result: Result) -> None:
    assert result.plan is not None

    def point(minutes: float, value: float, *stops: str) -> FrontPoint:
        return FrontPoint(
            inf, minutes / 60.0, 0.2, 0.1, value, value, stops, (), 20.03997, 0.006, 0.2, 0.01,
            0.006, True, result.plan,  # type: ignore[arg-type]
        )  # fmt: skip

    points = (
        point(13.06, 21.0708598, "km 300"),
        point(19.15, 20.1525458, "km 200"),
        point(19.30, 20.1524081, *[f"Trafikplats {i}" for i in range(9)]),
        point(20.00, 20.15, ),
    )  # fmt: skip
    front = Front("t", "energy", "kWh", points, {}, (), (), 0.01, "time limit reached", {})
    text = format_front(front)
    assert max(map(len, text.split("\n"))) <= WIDTH
    values = [row.split()[1] for row in text.split("\n") if re.match(r"\d", row)]
    assert values == ["21.071", "20.153", "20.152", "20.150"]
    assert "Not complete: time limit reached." in text
    plain = dataclasses.replace(front, points=points[:2])
    assert " 21.07 " in format_front(plain), "no more digits than needed"
    assert format_front(dataclasses.replace(front, points=())).startswith("t: no plan found (")


def test_a_list_of_names_is_hung_beside_them() -> None:
    rows = paragraph("  goteborg-stockholm", "words " * 30, 28).split("\n")
    assert len(rows) > 2 and max(map(len, rows)) <= WIDTH
    assert {row.index("words") for row in rows} == {28}
    assert paragraph("  bare", "", 28) == "  bare"


def test_cabin_cooling_has_a_row_where_there_is_any() -> None:
    for ambient_c, there, absent in (
        (30.0, "cabin cooling", "cabin heating by heater"),
        (-5.0, "cabin heating by heater", "cabin cooling"),
    ):
        trip = small_trip(ambient_c=ambient_c, start_soc=0.45)
        found = plan(trip)
        text = format_result(found, trip)
        assert re.search(f"^{there} ", text, re.M) and absent not in text
        assert found.plan is not None
        if there == "cabin cooling":
            (row,) = [numbers(r) for r in text.split("\n") if r.startswith(there)]
            assert row[0] == pytest.approx(found.plan.totals_kwh["cabin_cooling"], abs=0.0051)
            (drive,) = [numbers(r) for r in text.split("\n") if r.startswith("propulsion and")]
            both = found.plan.totals_kwh["propulsion_and_auxiliaries"]
            assert drive[0] + row[0] == pytest.approx(both, abs=0.011)


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
    assert "finer grid" not in text
    refused = (rows[0], dataclasses.replace(rows[1], reason=f"{REFUSED}: too hot by 1 K"))
    text = format_result(without_plan(Status.UNKNOWN, refused))
    assert "none is ruled out; a finer grid may give one" in " ".join(text.split())


def test_a_long_word_column_wraps_and_keeps_its_place() -> None:
    text = table(["a", "b", "why"], [["x" * 30, "1", "word " * 40], ["y", "2", "short"]], True)
    rows = text.split("\n")
    assert max(len(r) for r in rows) <= WIDTH and len(rows) > 4
    assert len({r.index("word") for r in rows if "word" in r}) == 1
