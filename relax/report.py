"""Owns what a caller reads of a plan: stops, sums and arrays, from the replayed drive.

States, energies, times and costs are those of the replay; powers within a step
are those of the transcription, whose deviation from the replay is stated beside.
Knows nothing of how the plan was found.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from relax.execute import Execution
from relax.instance import Instance
from relax.maps import Table2
from relax.plan import StopTrajectory, Trajectory
from relax.trip import DRIVE

if TYPE_CHECKING:
    from relax.driven import Replay, ReplayStop
    from relax.trip import Trip

__all__ = ["ChargeTrace", "Deviation", "DriveTrace", "PlanReport", "StopReport", "make_report"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class StopReport:
    """One stop as driven; SoC after the detour in and before the detour out.

    Parameters
    ----------
    charger : str
        Name.
    position_km : float
        Where [km].
    arrive_soc, depart_soc : float
        State of charge.
    arrive_temperature_c, depart_temperature_c : float
        Battery temperature [degrees C].
    dwell_h, detour_h : float
        Time charging and lost on the detour [h].
    grid_kwh : float
        Energy paid for [kWh].
    cost : float
        Energy, time, occupancy, detour and penalty [currency].
    energy_cost : float
        Of which energy [currency].
    arrive_h, depart_h : float
        Clock since departure when plugging in and out [h].
    """

    charger: str
    position_km: float
    arrive_soc: float
    depart_soc: float
    arrive_temperature_c: float
    depart_temperature_c: float
    dwell_h: float
    detour_h: float
    grid_kwh: float
    cost: float
    energy_cost: float
    arrive_h: float
    depart_h: float

    @property
    def average_kw(self) -> float:
        """Mean grid power over the dwell [kW]."""
        return self.grid_kwh / self.dwell_h if self.dwell_h > 0.0 else 0.0


@dataclass(frozen=True)
class DriveTrace:
    """Driving over distance; arrays of shape (n,), states (n + 1,) on arrival at the nodes.

    Parameters
    ----------
    node_km, soc, temperature_c : ndarray, shape (n + 1,)
        Step borders and the replayed state there.
    duration_h : ndarray
        Time of each step [h].
    battery_kw, propulsion_kw, loss_kw : ndarray
        Internal battery power, propulsion, Joule loss [kW].
    charge_limit_kw, discharge_limit_kw : ndarray
        Limits of the battery power at the start of each step, both >= 0 [kW].
    battery_heater_kw, battery_cooling_kw : ndarray
        Electrical powers [kW].
    cabin_heater_kw, heat_pump_kw, heat_pump_heat_kw : ndarray
        Cabin heating: heater power, compressor power, heat of the pump [kW].
    refused_kw : ndarray
        Recuperation the battery could not take [kW].
    """

    node_km: Array
    soc: Array
    temperature_c: Array
    duration_h: Array
    battery_kw: Array
    propulsion_kw: Array
    loss_kw: Array
    charge_limit_kw: Array
    discharge_limit_kw: Array
    battery_heater_kw: Array
    battery_cooling_kw: Array
    cabin_heater_kw: Array
    heat_pump_kw: Array
    heat_pump_heat_kw: Array
    refused_kw: Array


@dataclass(frozen=True)
class ChargeTrace:
    """One stop over time; arrays of shape (K,), states (K + 1,) at the cell borders.

    Parameters
    ----------
    charger : str
        Name.
    time_h, soc, temperature_c : ndarray, shape (K + 1,)
        Time since plugging in and the replayed state.
    grid_kw, battery_kw, limit_kw, loss_kw : ndarray
        Grid power, internal charging power, its limit, Joule loss [kW].
    battery_heater_kw, battery_cooling_kw : ndarray
        Electrical powers [kW].
    cabin_heater_kw, heat_pump_kw, heat_pump_heat_kw : ndarray
        Cabin heating [kW].
    """

    charger: str
    time_h: Array
    soc: Array
    temperature_c: Array
    grid_kw: Array
    battery_kw: Array
    limit_kw: Array
    loss_kw: Array
    battery_heater_kw: Array
    battery_cooling_kw: Array
    cabin_heater_kw: Array
    heat_pump_kw: Array
    heat_pump_heat_kw: Array


@dataclass(frozen=True)
class Deviation:
    """How far the transcription is from the replay.

    Parameters
    ----------
    cost : float
        Relative difference of the costs.
    soc : float
        Largest difference of the SoC at a node, in SoC.
    temperature_k : float
        Largest difference of the battery temperature at a node [K].
    """

    cost: float
    soc: float
    temperature_k: float


@dataclass(frozen=True)
class PlanReport:
    """A plan as a caller reads it.

    Parameters
    ----------
    stops : tuple of StopReport
        In driving order.
    grid_kwh, charging_h, detour_h, driving_h : float
        Sums over the trip.
    final_soc, final_temperature_c : float
        At the destination.
    totals_kwh : dict of str to float
        Energies by use, replayed; of ``propulsion_and_auxiliaries``, what cabin cooling took
        is named again as ``cabin_cooling``.
    drive : DriveTrace
        Arrays over distance.
    charge : tuple of ChargeTrace
        Arrays over time, one per stop.
    deviation : Deviation
        Transcription against replay.
    """

    stops: tuple[StopReport, ...]
    grid_kwh: float
    charging_h: float
    detour_h: float
    driving_h: float
    final_soc: float
    final_temperature_c: float
    totals_kwh: dict[str, float]
    drive: DriveTrace
    charge: tuple[ChargeTrace, ...]
    deviation: Deviation

    @property
    def stop_time_h(self) -> float:
        """Charging and detours: what ``limits.stop_time_h`` bounds [h]."""
        return self.charging_h + self.detour_h

    @property
    def total_h(self) -> float:
        """Driving, charging and detours [h]."""
        return self.driving_h + self.stop_time_h

    def trajectory(self) -> dict[str, dict[str, Array]]:
        """Return all arrays by name: ``drive`` and one entry per stop, named by its charger."""
        traces: dict[str, dict[str, Array]] = {DRIVE: asdict(self.drive)}
        for trace in self.charge:
            arrays = asdict(trace)
            arrays.pop("charger")
            traces[trace.charger] = arrays
        return traces


def make_report(trip: Trip, instance: Instance, done: Execution) -> PlanReport:
    """Return the report of an executed plan.

    Parameters
    ----------
    trip : Trip
        The trip.
    instance : Instance
        Transcription of the plan's subset.
    done : Execution
        Must have a replay.

    Raises
    ------
    ValueError
        The plan was never driven to its end.
    """
    driven = done.replay
    if driven is None:
        raise ValueError("a plan without a replay has nothing to report")
    pack = trip.vehicle.pack
    clock = np.concatenate([[0.0], np.cumsum(instance.drive.duration_h)])
    reports: list[StopReport] = []
    waited = 0.0
    for stop, ran in zip(instance.stops, driven.stops, strict=True):
        spec = trip.chargers[stop.charger]
        arrive = float(clock[stop.node]) + waited + spec.detour_in_h
        reports.append(_stop_report(trip, ran, arrive))
        waited += ran.dwell_h + spec.detour_h
    final = float(pack.soc(driven.final_energy_kwh))
    return PlanReport(
        stops=tuple(reports),
        grid_kwh=sum(s.grid_kwh for s in reports),
        charging_h=sum(s.dwell_h for s in reports),
        detour_h=sum(s.detour_h for s in reports),
        driving_h=trip.route.driving_h,
        final_soc=final,
        final_temperature_c=driven.final_temperature_c,
        totals_kwh=driven.totals_kwh | {"cabin_cooling": _cabin_cooling_kwh(trip, driven)},
        drive=_drive_trace(instance, done.trajectory, driven),
        charge=tuple(
            _charge_trace(trip, plan, ran)
            for plan, ran in zip(done.trajectory.stops, driven.stops, strict=True)
        ),
        deviation=_deviation(instance, done.trajectory, driven),
    )


def _cabin_cooling_kwh(trip: Trip, driven: Replay) -> float:
    """Return the energy of cabin cooling [kWh]: weather and time decide it, no control does.

    The drive counts it in its base load, with the same powers over the same times.
    """
    power, route = trip.vehicle.cabin_cooling_kw, trip.route
    parked = sum(power.at(trip.chargers[s.charger].ambient_c) * s.dwell_h for s in driven.stops)
    return float(power(route.ambient_c) @ route.duration_h) + parked


def _stop_report(trip: Trip, ran: ReplayStop, arrive_h: float) -> StopReport:
    spec, pack = trip.chargers[ran.charger], trip.vehicle.pack
    return StopReport(
        charger=spec.name,
        position_km=spec.position_km,
        arrive_soc=float(pack.soc(ran.arrive_energy_kwh)),
        depart_soc=float(pack.soc(ran.depart_energy_kwh)),
        arrive_temperature_c=ran.arrive_temperature_c,
        depart_temperature_c=ran.depart_temperature_c,
        dwell_h=ran.dwell_h,
        detour_h=spec.detour_h,
        grid_kwh=ran.grid_kwh,
        cost=ran.cost,
        energy_cost=spec.price_per_kwh * ran.grid_kwh,
        arrive_h=arrive_h,
        depart_h=arrive_h + ran.dwell_h,
    )


def _limits(table: Table2, energy: Array, temperature: Array) -> Array:
    """Return a limit along a plan, which may leave the table by what counts as no violation."""
    inside = np.clip(energy, table.x[0], table.x[-1]), np.clip(temperature, table.y[0], table.y[-1])
    return table(*inside)


def _drive_trace(instance: Instance, plan: Trajectory, driven: Replay) -> DriveTrace:
    drive, pack = instance.drive, instance.vehicle.pack
    energy, temp = plan.energy_start_kwh, plan.temperature_start_c
    return DriveTrace(
        node_km=drive.node_km,
        soc=pack.soc(driven.node_energy_kwh),
        temperature_c=driven.node_temperature_c,
        duration_h=drive.duration_h,
        battery_kw=plan.power_kw,
        propulsion_kw=drive.propulsion_kw,
        loss_kw=plan.loss_kw,
        charge_limit_kw=_limits(pack.charge_limit_kw, energy, temp),
        discharge_limit_kw=_limits(pack.discharge_limit_kw, energy, temp),
        battery_heater_kw=plan.heater_kw,
        battery_cooling_kw=plan.cooling_kw,
        cabin_heater_kw=plan.cabin_heater_kw,
        heat_pump_kw=plan.heat_pump_kw,
        heat_pump_heat_kw=plan.pump_heat_kw,
        refused_kw=plan.brake_kw,
    )


def _charge_trace(trip: Trip, plan: StopTrajectory, ran: ReplayStop) -> ChargeTrace:
    hours = np.maximum(plan.dwell_h, 1e-12)
    return ChargeTrace(
        charger=trip.chargers[ran.charger].name,
        time_h=ran.clock_h,
        soc=trip.vehicle.pack.soc(ran.energy_kwh),
        temperature_c=ran.temperature_c,
        grid_kw=plan.grid_kwh / hours,
        battery_kw=plan.power_kw,
        limit_kw=plan.limit_kw,
        loss_kw=plan.loss_kwh / hours,
        battery_heater_kw=plan.heater_kw,
        battery_cooling_kw=plan.cooling_kw,
        cabin_heater_kw=plan.cabin_heater_kw,
        heat_pump_kw=plan.heat_pump_kw,
        heat_pump_heat_kw=plan.pump_heat_kw,
    )


def _deviation(instance: Instance, plan: Trajectory, driven: Replay) -> Deviation:
    pack = instance.vehicle.pack
    soc = pack.soc(plan.energy_kwh) - pack.soc(driven.node_energy_kwh)
    return Deviation(
        cost=driven.cost / plan.cost - 1.0 if plan.cost else 0.0,
        soc=float(np.abs(soc).max()),
        temperature_k=float(np.abs(plan.temperature_c - driven.node_temperature_c).max()),
    )
