"""Owns the judge of a plan: the car driving it on the continuous model, sample by sample.

Written apart from the transcription: it reads the trip, not the instance's
averages, and integrates with an adaptive Runge-Kutta method. The controls are
schedules, followed as far as the actuators can; at a stop the car charges to the
planned energy, the battery and the charger clip the power, and the dwell is an
outcome. Imports neither solver nor program. The only source of reported costs.
"""

from __future__ import annotations

import dataclasses
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from relax.commands import check_controls, within_ratings
from relax.driven import Arrival, Replay, ReplayStop, Violation
from relax.errors import DomainError, InputError
from relax.exact import ExactCar, discharge_power
from relax.instance import HEATER_SHARE, LEAST_ROOM_KW, MIN_CHARGE_KWH, Instance, Stop
from relax.plan import Controls, StopControls

if TYPE_CHECKING:
    from collections.abc import Callable

    from relax.trip import Trip

__all__ = ["Replay", "ReplayStop", "Violation", "replay"]

Array = npt.NDArray[np.float64]

RELATIVE_TOLERANCE = 1e-9
"""Local error of the integrator, relative."""
ABSOLUTE_TOLERANCE = 1e-9
"""Local error of the integrator [kWh, K, h]."""
SHORTFALL_KWH = 1e-5
"""Missing energy that is rounding of the integration: a second parked [kWh]."""
EXCESS_K = 1e-3
"""Temperature excess that is rounding [K]."""
EXCESS_KW = 0.05
"""Excess over the sustained discharge limit that is rounding [kW]."""
ROUNDING_KW = 1e-6
"""Excess over a charger's limit that is rounding [kW]."""
EXCESS_H = 1e-4
"""Excess over the longest dwell, of one stop or of all, that is rounding: 0.4 s [h]."""
PIECES = 8
"""Into how many parts a span is cut in which a state leaves the tables: each is checked."""
RULE_STOP_TIME = "charging and detours beyond the time allowed for all stops"

# components of the integrated state: two states, the clock, and energies since departure
ENERGY, TEMPERATURE, CLOCK, GRID, LOSS, BASE, HEATER, CABIN = range(8)
COOLING, PUMP, PUMP_HEAT, AMBIENT, DRIVETRAIN, BRAKE = range(8, 14)


class _Driver:
    """Carries the state along the trip and notes what breaks.

    ``car`` reads tables where they are defined, ``edge`` a little beyond too.
    """

    def __init__(self, trip: Trip, instance: Instance) -> None:
        from scipy.integrate import ode

        self.trip, self.instance = trip, instance
        self.car, self.edge = ExactCar(trip.vehicle), ExactCar(trip.vehicle, edge=True)
        self.km = 0.0
        self.state = [instance.start_energy_kwh, instance.start_temperature_c, *[0.0] * 12]
        self.violations: dict[str, Violation] = {}
        self.grid_excess_kw = 0.0
        self._ode = ode

    @property
    def here(self) -> tuple[float, float]:
        """Energy and temperature."""
        return self.state[ENERGY], self.state[TEMPERATURE]

    @property
    def arrival(self) -> Arrival:
        """All there is to know to go on from here."""
        return Arrival(tuple(self.state), tuple(self.violations.values()))

    def resume(self, arrival: Arrival) -> None:
        """Go on from an arrival."""
        self.state = list(arrival.state)
        self.violations = {v.rule: v for v in arrival.violations}

    def integrate(self, rates: Callable[[ExactCar, list[float]], list[float]], span: float) -> None:
        """Advance the state over a span of the independent variable.

        If a state on the way is off a table, once more at the tables' edges, with a look at
        the limits after every part: how much is missed is what a repair needs to know.
        """
        begin = list(self.state)
        try:
            self._advance(self.car, rates, span)
        except DomainError:
            self.state = begin
            for _ in range(PIECES):
                self._advance(self.edge, rates, span / PIECES)
                self._check_tables()

    def _advance(
        self,
        car: ExactCar,
        rates: Callable[[ExactCar, list[float]], list[float]],
        span: float,
    ) -> None:
        """Advance the state over a span with tables as one car reads them."""
        failed: list[DomainError] = []

        def guarded(_: float, y: Any) -> list[float]:
            if failed:
                return [0.0] * len(y)
            try:  # an exception must not cross the integrator's compiled code
                return rates(car, y.tolist())  # plain floats: a third of the time
            except DomainError as error:
                failed.append(error)
                return [0.0] * len(y)

        solver = self._ode(guarded).set_integrator(
            "dopri5",
            rtol=RELATIVE_TOLERANCE,
            atol=ABSOLUTE_TOLERANCE,
            first_step=span,
            nsteps=10000,
        )
        solver.set_initial_value(self.state, 0.0)
        self.state = solver.integrate(span).tolist()
        if failed:
            raise failed[0]
        if not solver.successful():
            raise DomainError("the integration of the continuous model did not converge")

    def note(self, rule: str, km: float, amount: float, unit: str, allowed: float) -> None:
        """Keep the largest violation of every rule."""
        if amount > allowed and (
            rule not in self.violations or amount > self.violations[rule].amount
        ):
            self.violations[rule] = Violation(rule, km, amount, unit)

    def check_temperature(self, km: float) -> None:
        """Note a temperature outside the limits."""
        self._temperature_within(
            km, self.instance.temperature_min_c, self.instance.temperature_max_c
        )

    def _temperature_within(self, km: float, low: float, top: float) -> None:
        temp = self.state[TEMPERATURE]
        self.note("battery temperature above its limit", km, temp - top, "K", EXCESS_K)
        self.note("battery temperature below its limit", km, low - temp, "K", EXCESS_K)

    def _check_tables(self) -> None:
        """Note a state outside the limits, or outside the tables should these be narrower."""
        instance, (empty, full) = self.instance, self.edge.energy_range
        coldest, hottest = self.edge.temperature_range
        low = max(instance.temperature_min_c, coldest)
        self._temperature_within(self.km, low, min(instance.temperature_max_c, hottest))
        short = empty - self.state[ENERGY]
        self.note("energy below the least on the way", self.km, short, "kWh", SHORTFALL_KWH)
        self.check_full(self.km, min(instance.ceiling_kwh, full))

    def check_full(self, km: float, most: float) -> None:
        """Note an energy above the largest allowed."""
        over = self.state[ENERGY] - most
        self.note("energy above the largest allowed", km, over, "kWh", SHORTFALL_KWH)

    def brake(self, k: int, heater: float, cooling: float, pump: float) -> float:
        """Return the recuperation refused over step k, from its mean power at its start [kW].

        The charge limit is a sustained limit: it holds for the mean over a
        step, as in the transcription; pulses within are allowed.
        """
        drive = self.instance.drive
        if drive.base_kw[k] >= 0.0:
            return 0.0
        energy, temp = self.state[ENERGY], self.state[TEMPERATURE]
        car = self.edge
        r = car.resistance(temp) / car.voltage_squared(energy)
        heater, pump, _, cabin = car.heating(temp, float(drive.cabin_heat_kw[k]), heater, pump)
        ripple = float(drive.ripple_kw2[k])
        load = float(drive.base_kw[k]) + heater + cooling + pump + cabin
        limit = car.charge_limit(energy, temp)
        if discharge_power(load + r * ripple, r) >= -limit:
            return 0.0
        return max(-limit - r * (limit * limit + ripple) - load, 0.0)

    def drive_sample(
        self, j: int, hours: float, setting: tuple[float, float, float], brake: float
    ) -> None:
        """Drive part of route sample j with constant settings."""
        route, vehicle = self.trip.route, self.trip.vehicle
        ambient = float(route.ambient_c[j])
        climate = (
            ambient,
            vehicle.heat_loss_kw_per_k.at(float(route.speed_kmh[j])),
            float(route.drivetrain_heat_kw[j]),
        )
        demand = vehicle.cabin_heating_kw.at(ambient)
        base = float(route.propulsion_kw[j]) + vehicle.auxiliary_kw + brake
        base += vehicle.cabin_cooling_kw.at(ambient)
        heater_set, cooling_set, pump_set = setting
        ceiling = self.instance.ceiling_kwh

        def rates(car: ExactCar, y: list[float]) -> list[float]:
            energy, temp = y[0], y[1]
            heater, pump, heat, cabin = car.heating(temp, demand, heater_set, pump_set)
            r = car.resistance(temp) / car.voltage_squared(energy)
            heater, cooling = car.managed(temp, heater, cooling_set)
            load = base + heater + cooling + pump + cabin
            wanted = discharge_power(load, r)
            power = car.accepted(wanted, ceiling - energy)
            refused = power - r * power * power - load if power > wanted else 0.0
            use = (base + refused, heater, cooling, pump, heat, cabin)
            return [*car.rates(power, r, use, climate, 0.0, temp)[:BRAKE], brake + refused]

        self.integrate(rates, hours)

    def charge(self, stop: Stop, setting: StopControls, target_kwh: float, km: float) -> ReplayStop:
        """Charge to the planned energy; the independent variable is the internal energy."""
        state = self.state
        state[ENERGY] -= stop.detour_in_kwh
        short = stop.arrive_min_kwh - state[ENERGY]
        self.note("energy below the least on arrival at a charger", km, short, "kWh", SHORTFALL_KWH)
        begin = list(state)
        cells = setting.power_kw.size
        borders = [list(state)]
        climate = (stop.ambient_c, stop.heat_loss_kw_per_k, 0.0)
        part = (target_kwh - state[ENERGY]) / cells
        grid_limit = {c: c.over_energy(stop.grid_limit_kw) for c in (self.car, self.edge)}
        for j in range(cells if part > 0.0 else 0):
            power_set, heater_set, cooling_set, pump_set = (
                float(column[j])
                for column in (
                    setting.power_kw,
                    setting.heater_kw,
                    setting.cooling_kw,
                    setting.heat_pump_kw,
                )
            )

            def rates(
                car: ExactCar,
                y: list[float],
                power_set: float = power_set,
                heater_set: float = heater_set,
                cooling_set: float = cooling_set,
                pump_set: float = pump_set,
            ) -> list[float]:
                energy, temp = y[0], y[1]
                heater, pump, heat, cabin = car.heating(
                    temp, stop.cabin_heat_kw, heater_set, pump_set
                )
                r = car.resistance(temp) / car.voltage_squared(energy)
                grid_max = grid_limit[car](energy)
                free = grid_max - stop.base_kw - cabin - pump - cooling_set
                heater = max(min(heater, HEATER_SHARE * free), 0.0)
                room = max(free - heater, LEAST_ROOM_KW)
                limit = 2.0 * room / (1.0 + sqrt(1.0 + 4.0 * r * room))
                power = min(power_set, limit, car.charge_limit(energy, temp))
                if not power > 0.0:
                    raise DomainError(
                        f"the battery takes no charge at {energy:.4g} kWh, {temp:.4g} C"
                    )
                heater, cooling = car.managed(temp, heater, cooling_set)
                use = (stop.base_kw, heater, cooling, pump, heat, cabin)
                grid = power + r * power * power + stop.base_kw + heater + cooling + pump + cabin
                self.grid_excess_kw = max(self.grid_excess_kw, grid - grid_max)
                per_time = car.rates(-power, r, use, climate, grid, temp)
                return [rate / power for rate in per_time]

            self.integrate(rates, part)
            self.check_temperature(km)
            borders.append(list(self.state))
        state = self.state
        missing = MIN_CHARGE_KWH - (target_kwh - begin[ENERGY])
        self.note("energy charged below the least of a stop", km, missing, "kWh", SHORTFALL_KWH)
        dwell, grid = state[CLOCK] - begin[CLOCK], state[GRID] - begin[GRID]
        self.note("dwell beyond the longest allowed", km, dwell - stop.max_dwell_h, "h", EXCESS_H)
        self.check_full(km, self.instance.energy_max_kwh)
        excess, self.grid_excess_kw = self.grid_excess_kw, 0.0
        self.note("grid power above the charger's limit", km, excess, "kW", ROUNDING_KW)
        depart = state[ENERGY]
        state[ENERGY] -= stop.detour_out_kwh
        short = stop.leave_min_kwh - state[ENERGY]
        self.note("energy below the least after a stop", km, short, "kWh", SHORTFALL_KWH)
        occupied = max(0.0, dwell - stop.occupancy_free_h)
        trace = np.array(borders)
        return ReplayStop(
            charger=stop.charger,
            arrive_energy_kwh=begin[ENERGY],
            depart_energy_kwh=depart,
            arrive_temperature_c=begin[TEMPERATURE],
            depart_temperature_c=state[TEMPERATURE],
            dwell_h=dwell,
            grid_kwh=grid,
            cost=stop.price_per_kwh * grid
            + stop.time_price_per_h * dwell
            + stop.occupancy_price_per_h * occupied
            + stop.fixed_cost,
            energy_kwh=trace[:, ENERGY],
            temperature_c=trace[:, TEMPERATURE],
            clock_h=trace[:, CLOCK] - begin[CLOCK],
        )


def replay(
    trip: Trip,
    instance: Instance,
    controls: Controls,
    targets_kwh: tuple[float, ...],
    before: Replay | None = None,
) -> Replay:
    """Drive a plan on the continuous model and check every limit.

    Parameters
    ----------
    trip : Trip
        The trip; its route samples are what is driven.
    instance : Instance
        Says where the stops are and over which steps the controls hold.
    controls : Controls
        Schedules of heater, cooling and heat pump; planned charging powers. Powers beyond an
        actuator's rating are driven at the rating and listed in ``clipped``; the charged
        energies count for nothing here, the targets say where charging ends.
    targets_kwh : tuple of float
        Internal energy at which charging ends, one per stop [kWh].
    before : Replay, optional
        A drive of the same controls: up to the first stop with another target it is
        taken from there.

    Returns
    -------
    Replay
        Cost, states, energies by use, violations.

    Raises
    ------
    InputError
        Controls or targets mean nothing: another number of values, no number, a charging
        power that is not above 0. Names the command.
    DomainError
        The car leaves the maps' domain by more than a plan's repair could bring back (5 K,
        1 kWh), for example because it runs empty, or cannot go on. Says where, and what broke
        before. By less, the nearest point of the maps is taken, and the limit that is missed
        is a violation.

    Examples
    --------
    >>> from relax import idle_controls, load_trip, make_instance, replay, simulate
    >>> trip = load_trip("paper-400km")
    >>> instance = make_instance(trip, (0, 2))
    >>> controls = idle_controls(instance, energy_kwh=(20.0, 20.0))
    >>> trajectory = simulate(instance, controls)
    >>> targets = tuple(float(s.energy_kwh[-1]) for s in trajectory.stops)
    >>> driven = replay(trip, instance, controls, targets)
    >>> abs(driven.cost / trajectory.cost - 1.0) < 0.002, abs(driven.balance_kwh) < 1e-9
    (True, True)
    """
    check_controls(instance, controls)
    if np.shape(targets_kwh) != (len(instance.stops),) or not np.all(np.isfinite(targets_kwh)):
        raise InputError("controls", "targets_kwh", targets_kwh, "a number of kWh for every stop")
    followed, clipped = within_ratings(instance, controls)
    driver = _Driver(trip, instance)
    try:
        done = _driven(driver, followed, targets_kwh, before)
    except DomainError as error:
        broken = "".join(f"; {v}" for v in driver.violations.values())
        raise DomainError(f"at {driver.km:.1f} km: {error}{broken}") from error
    return dataclasses.replace(done, clipped=clipped)


def _driven(
    driver: _Driver, controls: Controls, targets_kwh: tuple[float, ...], before: Replay | None
) -> Replay:
    """Drive controls that the actuators can follow."""
    trip, instance = driver.trip, driver.instance
    route, drive = trip.route, instance.drive
    borders = np.union1d(route.node_km, drive.node_km)
    sample = np.searchsorted(route.node_km, 0.5 * (borders[1:] + borders[:-1]), "right") - 1
    step = np.searchsorted(drive.node_km, 0.5 * (borders[1:] + borders[:-1]), "right") - 1
    hours = np.diff(borders) / route.speed_kmh[sample]
    least = trip.vehicle.pack.energy_kwh(trip.soc_min(borders))
    node = {float(km): k for k, km in enumerate(drive.node_km)}
    states: list[tuple[float, float]] = []
    nodes: list[tuple[float, float]] = []
    stops: list[ReplayStop] = []
    arrivals: list[Arrival] = []
    resumed = -1
    if before is not None and before.arrivals:
        same = [a == b for a, b in zip(before.targets_kwh, targets_kwh, strict=True)]
        m = [*same[:-1], False].index(False)
        stop = instance.stops[m]
        resumed = int(np.searchsorted(borders, drive.node_km[stop.node]))
        states = _pairs(before.energy_kwh, before.temperature_c, resumed + 1)
        nodes = _pairs(before.node_energy_kwh, before.node_temperature_c, stop.node + 1)
        stops, arrivals = list(before.stops[:m]), list(before.arrivals[:m])
        driver.resume(before.arrivals[m])
    k, brake, step_start = -1, 0.0, (0.0, 0.0)
    for i, km in enumerate(borders.tolist()):
        if i < resumed:
            continue
        driver.km = km
        if i > resumed:
            states.append(driver.here)
            short = float(least[i]) - driver.state[ENERGY]
            driver.note("energy below the least on the way", km, short, "kWh", SHORTFALL_KWH)
            driver.check_temperature(km)
            driver.check_full(km, instance.ceiling_kwh)
        if km in node:
            if k >= 0:
                _check_power(driver, k, step_start, km)
            if i > resumed:
                nodes.append(driver.here)
            k = node[km]
            while len(stops) < len(instance.stops) and instance.stops[len(stops)].node == k:
                m = len(stops)
                arrivals.append(driver.arrival)
                stops.append(
                    driver.charge(instance.stops[m], controls.stops[m], targets_kwh[m], km)
                )
            if k < drive.n_steps:
                setting = (
                    float(controls.heater_kw[k]),
                    float(controls.cooling_kw[k]),
                    float(controls.heat_pump_kw[k]),
                )
                brake = driver.brake(k, *setting)
                step_start = driver.here
        if i < hours.size:
            assert k == step[i]
            driver.drive_sample(int(sample[i]), float(hours[i]), setting, brake)
    short = instance.end_energy_min_kwh - driver.state[ENERGY]
    driver.note("energy below the least at the end", route.length_km, short, "kWh", SHORTFALL_KWH)
    over = sum(s.dwell_h for s in stops) - instance.total_dwell_h if stops else 0.0
    driver.note(RULE_STOP_TIME, route.length_km, over, "h", EXCESS_H)
    done = _report(driver, stops, borders, np.array(states), np.array(nodes))
    return dataclasses.replace(done, targets_kwh=tuple(targets_kwh), arrivals=tuple(arrivals))


def _pairs(energy: Array, temp: Array, count: int) -> list[tuple[float, float]]:
    """Return the first states of a drive."""
    return list(zip(energy[:count].tolist(), temp[:count].tolist(), strict=True))


def _check_power(driver: _Driver, k: int, start: tuple[float, float], km: float) -> None:
    """Check the mean power of step k against the sustained discharge limit."""
    energy, temp = driver.state[ENERGY], driver.state[TEMPERATURE]
    mean = (start[0] - energy) / float(driver.instance.drive.duration_h[k])
    limit = driver.edge.discharge_limit(0.5 * (start[0] + energy), 0.5 * (start[1] + temp))
    driver.note("power above the discharge limit", km, mean - limit, "kW", EXCESS_KW)


def _report(
    driver: _Driver,
    stops: list[ReplayStop],
    borders: Array,
    states: Array,
    nodes: Array,
) -> Replay:
    """Sum up, and close the two energy balances."""
    state, instance, vehicle = driver.state, driver.instance, driver.trip.vehicle
    detours = sum(s.detour_in_kwh + s.detour_out_kwh for s in instance.stops)
    used = state[BASE] + state[HEATER] + state[CABIN] + state[COOLING] + state[PUMP]
    drawn = instance.start_energy_kwh - state[ENERGY] - detours
    stored = (state[TEMPERATURE] - instance.start_temperature_c) * driver.car.capacity
    heat = (
        state[LOSS]
        + state[DRIVETRAIN]
        + vehicle.heater_battery_efficiency * state[HEATER]
        - vehicle.cooling_cop * state[COOLING]
        - (state[PUMP_HEAT] - state[PUMP])
        + state[AMBIENT]
    )
    return Replay(
        cost=sum(s.cost for s in stops),
        stops=tuple(stops),
        position_km=borders,
        energy_kwh=states[:, ENERGY],
        temperature_c=states[:, TEMPERATURE],
        node_energy_kwh=nodes[:, ENERGY],
        node_temperature_c=nodes[:, TEMPERATURE],
        final_energy_kwh=state[ENERGY],
        final_temperature_c=state[TEMPERATURE],
        totals_kwh={
            "grid": state[GRID],
            "loss": state[LOSS],
            "propulsion_and_auxiliaries": state[BASE] - state[BRAKE],
            "refused_recuperation": state[BRAKE],
            "detours": detours,
            "battery_heater": state[HEATER],
            "cabin_heater": state[CABIN],
            "battery_cooling": state[COOLING],
            "heat_pump": state[PUMP],
            "heat_pump_heat": state[PUMP_HEAT],
        },
        balance_kwh=state[GRID] + drawn - state[LOSS] - used,
        heat_balance_kwh=stored - heat,
        violations=tuple(driver.violations.values()),
    )
