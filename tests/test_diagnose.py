"""A remedy that is named was tried: with it there is a plan, and without it there is none."""

from __future__ import annotations

import re
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from test_simulate import toy_trip
from trips import small_trip

from enumerate import Diagnosis, Status, plan
from enumerate.diagnose import diagnose
from enumerate.show import format_result
from relax import Table2, Trip, load_trip, make_drive, make_instance


def diagnosed(trip: Trip) -> Diagnosis:
    return diagnose(trip, make_drive(trip, trip.grid.step_km))


def limited(trip: Trip, *dwells_h: float, stop_time_h: float = np.inf) -> Trip:
    """The trip with other longest dwells, and a limit of all time."""
    chargers = tuple(
        replace(c, max_dwell_h=h) for c, h in zip(trip.chargers, dwells_h, strict=True)
    )
    return replace(trip, chargers=chargers, stop_time_h=stop_time_h)


def remedied(trip: Trip, remedy: str) -> Trip:
    """The trip with a remedy taken by its words."""
    for part in remedy.split(" together with "):
        field, value = part.split(" of about ")
        if field == "limits.stop_time_h":
            trip = replace(trip, stop_time_h=float(value))
            continue
        match = re.fullmatch(r"charger\.(.*)\.max_dwell_min", field)
        assert match is not None, remedy
        chargers = tuple(
            replace(c, max_dwell_h=float(value) / 60.0) if c.name == match[1] else c
            for c in trip.chargers
        )
        trip = replace(trip, chargers=chargers)
    return trip


EMPTY = small_trip(start_soc=0.3, end_soc_min=0.3)
"""Needs 19 kWh on the way."""
CASES: dict[str, tuple[Trip, str]] = {
    "all time, paper": (load_trip("paper-400km", {"limits.stop_time_h": 0.25}), "S"),
    "all time": (limited(EMPTY, 4.0, 1.5, stop_time_h=0.2), "S"),
    "first dwell": (limited(EMPTY, 0.05, 0.05), "D"),
    "either dwell": (limited(replace(EMPTY, start_soc=0.4), 0.05, 0.05), "DD"),
    "one dwell of two": (limited(EMPTY, 0.1, 0.01, stop_time_h=0.45), "D"),
    "both": (limited(EMPTY, 0.05, 0.05, stop_time_h=0.2), "+"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_named_helps_and_was_missing(name: str) -> None:
    trip, kinds = CASES[name]
    assert plan(trip).plan is None
    found = diagnosed(trip)
    got = ["+" if "together" in r else "S" if "stop_time_h" in r else "D" for r in found.remedies]
    assert "".join(got) == kinds, found.remedies
    for remedy in found.remedies:
        assert plan(remedied(trip, remedy)).plan is not None, remedy
    assert ("all" in name or name == "both") == ("the time for charging" in found.reason)
    assert ("all" in name) != ("the longest dwell" in found.reason)


def test_two_dwells_that_only_help_together_are_one_remedy() -> None:
    """The first alone ends below the least energy, the second alone is out of reach."""
    full = Table2([0.0, 1.0], [-40.0, 60.0], np.full((2, 2), 60.0))
    trip = toy_trip(start_soc=0.25, end_soc_min=0.28, soc_max=0.4, pack__charge_limit_soc_kw=full)
    trip = limited(trip, 0.02, 0.02)
    assert plan(trip).plan is None
    found = diagnosed(trip)
    (remedy,) = found.remedies
    assert remedy.count("max_dwell_min") == 2
    assert plan(remedied(trip, remedy)).plan is not None


def test_no_time_limit_is_named_where_the_pack_is_too_weak() -> None:
    weak = Table2([0.0, 1.0], [-40.0, 60.0], np.full((2, 2), 12.0))
    trip = limited(toy_trip(pack__discharge_limit_soc_kw=weak), 0.05, 0.05, stop_time_h=0.1)
    assert plan(trip).plan is None
    found = diagnosed(trip)
    assert found.remedies == ()
    assert found.reason.endswith("temperature, discharge power or the least energy")


def test_a_reason_takes_no_longer_than_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    trip, _ = CASES["both"]
    instance = make_instance(trip, ())
    late = diagnose(trip, instance.drive, deadline=time.perf_counter())
    assert late.remedies == () and late.reason.endswith("no time to find out which")

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["enumerate.search"], "diagnose", stopped)
    result = plan(trip)
    assert result.status is Status.INFEASIBLE and result.diagnosis is None
    assert "infeasible" in format_result(result, trip)


def test_a_charger_is_proposed_only_where_a_full_battery_lasts_from_there() -> None:
    trip = load_trip("paper-400km", {"route.ambient_c": 10.0})
    alone = replace(trip, chargers=())
    place = re.compile(r"a charger between (\d+) km and (\d+) km")
    found = [place.match(text) for text in diagnosed(alone).remedies]
    first, last = (float(x) for x in next(m for m in found if m).groups())
    assert 0.0 < first < last < trip.route.length_km

    def at(km: float) -> Status:
        spec = replace(trip.chargers[0], position_km=km, detour_in_kwh=0.0, detour_out_kwh=0.0)
        return plan(replace(alone, chargers=(spec,))).status

    for km in (first + 1.0, last - 1.0):
        assert at(km) in (Status.FEASIBLE, Status.OPTIMAL)
    assert at(first - 40.0) is Status.INFEASIBLE


def test_where_one_charger_is_not_enough_several_are_proposed() -> None:
    far = replace(load_trip("long-1000km-winter"), chargers=())
    assert diagnosed(far).remedies == ("several chargers between 0 km and 1000 km",)
