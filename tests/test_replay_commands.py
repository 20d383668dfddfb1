"""Commands a car cannot follow: taken back to its ratings and listed, or refused by name.

The same for simulation and drive: neither may find a plan cheaper, or dearer, than the car can.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trips import small_trip

from benchmarks.judge import judge
from relax import (
    Controls,
    InputError,
    Instance,
    Replay,
    Trip,
    execute,
    idle_controls,
    load_trip,
    make_instance,
    refine,
    replay,
    simulate,
)
from relax.commands import within_ratings
from relax.plan import StopControls

HOT = small_trip(ambient_c=33.0)
RATINGS = {"heater_kw": 6.0, "cooling_kw": 2.0, "heat_pump_kw": 1.0}
"""Of the small car [kW]."""


def claimed(trip: Trip) -> tuple[Instance, Controls, tuple[float, ...]]:
    """A plan that may cool: hot enough that every command counts."""
    instance = make_instance(trip, (0,))
    controls = idle_controls(instance, (10.0,))
    return instance, controls, tuple(float(s.energy_kwh[-1]) for s in simulate_stops(trip))


def simulate_stops(trip: Trip) -> tuple[Any, ...]:
    instance = make_instance(trip, (0,))
    return simulate(instance, idle_controls(instance, (10.0,))).stops


def with_stop(controls: Controls, **changes: Any) -> Controls:
    return replace(controls, stops=(replace(controls.stops[0], **changes),))


def same_drive(a: Replay, b: Replay) -> None:
    assert (a.cost, a.final_energy_kwh, a.final_temperature_c) == (
        b.cost, b.final_energy_kwh, b.final_temperature_c
    )  # fmt: skip
    np.testing.assert_array_equal(a.energy_kwh, b.energy_kwh)
    np.testing.assert_array_equal(a.temperature_c, b.temperature_c)


@pytest.mark.parametrize("ambient_c", [33.0, -5.0])
@pytest.mark.parametrize("asked", [1.5, 20.0, -3.0, np.inf])
@pytest.mark.parametrize("name", RATINGS)
def test_beyond_a_rating_the_car_does_what_it_can(
    name: str, asked: float, ambient_c: float
) -> None:
    """Driven as if the rating had been commanded, on the road and at the stop; and said so."""
    trip = small_trip(ambient_c=ambient_c)
    instance, controls, targets = claimed(trip)
    most = RATINGS[name]
    kw = asked if asked < 0.0 else most * asked
    given = float(np.clip(kw, 0.0, most))
    n, cells = instance.drive.n_steps, instance.cells

    def commanded(power: float) -> Controls:
        there = with_stop(controls, **{name: np.full(cells, power)})
        late: dict[str, Any] = {name: np.where(np.arange(n) >= 4, power, 0.0)}
        return replace(there, **late)

    wild, tame = commanded(kw), commanded(given)
    got, wanted = (replay(trip, instance, c, targets) for c in (wild, tame))
    same_drive(got, wanted)
    assert got.violations == wanted.violations
    assert wanted.clipped == ()
    (clipped,) = got.clipped
    assert (clipped.command, clipped.asked_kw, clipped.given_kw) == (name, kw, given)
    assert clipped.position_km == instance.drive.node_km[4]
    assert simulate(instance, wild).cost == simulate(instance, tame).cost
    assert (simulate(instance, wild).energy_kwh == simulate(instance, tame).energy_kwh).all()


def test_the_largest_excess_is_listed_with_its_place() -> None:
    instance, controls, targets = claimed(HOT)
    cooling = np.zeros(instance.drive.n_steps)
    cooling[[2, 7, 9]] = 2.5, 4.0, 3.0
    cells = np.full(instance.cells, 3.5)
    wild = with_stop(replace(controls, cooling_kw=cooling), cooling_kw=cells)
    (clipped,) = replay(HOT, instance, wild, targets).clipped
    assert str(clipped) == f"cooling_kw of 4 at {instance.drive.node_km[7]:.1f} km: the car gives 2"
    cells[3] = 5.0
    (clipped,) = replay(HOT, instance, wild, targets).clipped
    assert (clipped.position_km, clipped.asked_kw) == (45.0, 5.0)


def test_rounding_is_taken_back_without_a_word() -> None:
    """Solvers overshoot by 1e-8: that is not worth a line, and not worth a cent."""
    instance, controls, targets = claimed(HOT)
    full, over = (np.full(instance.drive.n_steps, kw) for kw in (2.0, 2.0 + 1e-8))
    exact = replay(HOT, instance, replace(controls, cooling_kw=full), targets)
    got = replay(HOT, instance, replace(controls, cooling_kw=over), targets)
    same_drive(got, exact)
    assert got.clipped == ()


@pytest.mark.parametrize("subset", [(1,), (0, 2)])
def test_a_plan_within_the_ratings_is_not_touched(subset: tuple[int, ...]) -> None:
    instance = make_instance(load_trip("paper-400km"), subset)
    plan = refine(instance, idle_controls(instance, (20.0,) * len(subset)))
    followed, clipped = within_ratings(instance, plan.controls)
    assert followed is plan.controls
    assert clipped == ()


def test_a_resumed_drive_lists_what_a_fresh_one_does() -> None:
    instance, controls, targets = claimed(HOT)
    wild = replace(controls, cooling_kw=np.full(instance.drive.n_steps, 9.0))
    first = replay(HOT, instance, wild, targets)
    again = replay(HOT, instance, wild, (targets[0] + 1.0,), first)
    fresh = replay(HOT, instance, wild, (targets[0] + 1.0,))
    same_drive(again, fresh)
    assert again.clipped == fresh.clipped == first.clipped != ()


# What means nothing is refused: the same words from simulation and drive.


def _cells(value: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    values = np.full(12, 5.0)
    values[3] = value
    return values


NONSENSE: dict[str, tuple[Callable[[Controls], Controls], str, str]] = {
    "no power": (
        lambda c: with_stop(c, power_kw=_cells(0.0)), "stops[0].power_kw[3]", "more than 0 kW"
    ),
    "power out of the car": (
        lambda c: with_stop(c, power_kw=_cells(-5.0)), "stops[0].power_kw[3]", "more than 0 kW"
    ),
    "power is no number": (
        lambda c: with_stop(c, power_kw=_cells(np.nan)), "stops[0].power_kw[3]", "a number of kW"
    ),
    "no energy": (lambda c: with_stop(c, energy_kwh=0.0), "stops[0].energy_kwh", "more than 0 kWh"),
    "energy out of the car": (
        lambda c: with_stop(c, energy_kwh=-5.0), "stops[0].energy_kwh", "more than 0 kWh"
    ),
    "energy is no number": (
        lambda c: with_stop(c, energy_kwh=np.nan), "stops[0].energy_kwh", "more than 0 kWh"
    ),
    "heater is no number": (
        lambda c: replace(c, heater_kw=np.where(c.heater_kw == 0.0, np.nan, 0.0)),
        "heater_kw[0]",
        "a number of kW",
    ),
    "pump of a cell is no number": (
        lambda c: with_stop(c, heat_pump_kw=_cells(np.nan)),
        "stops[0].heat_pump_kw[3]",
        "a number of kW",
    ),
    "one step too few": (
        lambda c: replace(c, cooling_kw=c.cooling_kw[1:]), "cooling_kw", "one value for each of 31"
    ),
    "one step too many": (
        lambda c: replace(c, heater_kw=np.zeros(32)), "heater_kw", "one value for each of 31"
    ),
    "cells of different numbers": (
        lambda c: with_stop(c, heater_kw=np.zeros(5)), "stops[0].heater_kw", "each of 12 cells"
    ),
    "no cells": (
        lambda c: replace(c, stops=(StopControls(5.0, *(np.zeros(0),) * 4),)),
        "stops[0].power_kw",
        "each of 1 cells",
    ),
    "no stop": (lambda c: replace(c, stops=()), "stops", "one for each of 1 stops"),
    "a stop too many": (lambda c: replace(c, stops=c.stops * 2), "stops", "one for each of 1"),
}  # fmt: skip


@pytest.mark.parametrize("name", NONSENSE)
def test_what_means_nothing_is_refused_by_name(name: str) -> None:
    change, field, allowed = NONSENSE[name]
    instance, controls, targets = claimed(HOT)
    wrong = change(controls)
    for call in (lambda: simulate(instance, wrong), lambda: replay(HOT, instance, wrong, targets)):
        with pytest.raises(InputError) as caught:
            call()
        assert caught.value.field == field
        assert allowed in caught.value.allowed


@pytest.mark.parametrize("targets", [(), (np.nan,), (np.inf,), (20.0, 30.0)])
def test_targets_that_mean_nothing_are_refused(targets: tuple[float, ...]) -> None:
    instance, controls, _ = claimed(HOT)
    with pytest.raises(InputError, match="targets_kwh"):
        replay(HOT, instance, controls, targets)


@pytest.mark.parametrize("kw", [0.0, -5.0])
def test_a_refinement_from_a_start_without_power_says_so(kw: float) -> None:
    instance, controls, _ = claimed(HOT)
    with pytest.raises(InputError, match="power_kw"):
        refine(instance, with_stop(controls, power_kw=_cells(kw)))


def test_the_judge_pays_nobody_for_charging_backwards() -> None:
    """Time ran backwards at a negative power: the cost sank far below any plan's."""
    trip = small_trip()
    instance, controls, targets = claimed(trip)
    wrong = with_stop(controls, power_kw=np.full(12, -5.0))
    for given in (None, targets):
        verdict = judge(trip, (0,), wrong, given)
        assert verdict.outcome == "fails"
        assert "power_kw" in verdict.reason
    assert judge(trip, (0,), controls).outcome == "holds"
    assert execute(trip, instance, refine(instance, controls)).reason == ""
