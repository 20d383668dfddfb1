"""Owns the car as the model sees it: pack maps over stored energy, actuators, cabin, road load.

The state of charge lives here only as a coordinate: everything else in the
package works with the internal energy E [kWh], in which the battery dynamics
are exactly linear. Knows nothing of files, routes or chargers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from relax.errors import InputError
from relax.maps import Table1, Table2

__all__ = ["Pack", "RoadLoad", "Vehicle"]

Array = npt.NDArray[np.float64]


LARGEST_DROOP = 0.5
"""Share of its CoP that a heat pump may lose at full power: beyond, its heat falls with power."""
ROUNDING_KWH = 1e-4
"""Energy beyond a table that is rounding of a drive: its limits are met to less [kWh]."""


@dataclass(frozen=True)
class Pack:
    """Battery pack: open-circuit voltage, resistance, power limits, lumped heat capacity.

    Parameters
    ----------
    capacity_ah : float
        Charge between SoC 0 and 1 [Ah].
    ocv_v : Table1
        Open-circuit pack voltage over SoC [V].
    resistance_ohm : Table1
        Pack resistance over battery temperature [ohm over degrees C].
    charge_limit_soc_kw, discharge_limit_soc_kw : Table2
        Largest internal power while charging / discharging, both >= 0, over
        (SoC, degrees C) [kW].
    heat_capacity_kwh_per_k : float
        Lumped heat capacity [kWh/K].
    temperature_min_c, temperature_max_c : float
        Limits of the battery temperature [degrees C].

    Notes
    -----
    Equation (E1) of the maths page: E(soc) = C_b * integral of U_oc d soc. With U_oc
    affine between table nodes, U_oc^2 is *exactly* affine in E there, so
    ``voltage_squared`` loses nothing. The power limits are bilinear in (E, T)
    between their nodes.
    """

    capacity_ah: float
    ocv_v: Table1
    resistance_ohm: Table1
    charge_limit_soc_kw: Table2
    discharge_limit_soc_kw: Table2
    heat_capacity_kwh_per_k: float
    temperature_min_c: float
    temperature_max_c: float

    @cached_property
    def _node_energy(self) -> Array:
        soc, volt = self.ocv_v.x, self.ocv_v.f
        steps = 0.5 * (volt[1:] + volt[:-1]) * np.diff(soc)
        return np.concatenate([[0.0], np.cumsum(steps)]) * (self.capacity_ah / 1000.0)

    def energy_kwh(self, soc: npt.ArrayLike) -> Array:
        """Return the internal energy above the lowest SoC of the table [kWh] (E1)."""
        soc = np.asarray(soc, dtype=np.float64)
        volt = self.ocv_v(soc)
        i = np.clip(np.searchsorted(self.ocv_v.x, soc, side="right") - 1, 0, self.ocv_v.x.size - 2)
        part = 0.5 * (volt + self.ocv_v.f[i]) * (soc - self.ocv_v.x[i])
        return self._node_energy[i] + part * (self.capacity_ah / 1000.0)

    def soc(self, energy_kwh: npt.ArrayLike) -> Array:
        """Return the state of charge at an internal energy: the inverse of (E1).

        A drive may end an empty or a full battery beyond the table by rounding.
        """
        energy, nodes = np.asarray(energy_kwh, dtype=np.float64), self._node_energy
        inside = np.clip(energy, nodes[0], nodes[-1])
        energy = np.where(np.abs(energy - inside) <= ROUNDING_KWH, inside, energy)
        volt = np.sqrt(1000.0 * self.voltage_squared(energy))
        i = np.clip(np.searchsorted(nodes, energy, side="right") - 1, 0, nodes.size - 2)
        charge = 2.0 * (energy - nodes[i]) / (volt + self.ocv_v.f[i])
        return self.ocv_v.x[i] + charge * (1000.0 / self.capacity_ah)

    @cached_property
    def voltage_squared(self) -> Table1:
        """U_oc^2 / 1000 over internal energy [kW*ohm over kWh]; exact, piecewise affine."""
        return Table1(self._node_energy, self.ocv_v.f**2 / 1000.0, "voltage_squared")

    @cached_property
    def charge_limit_kw(self) -> Table2:
        """Largest charging power over (energy, temperature) [kW over kWh, degrees C]."""
        table = self.charge_limit_soc_kw
        return Table2(self.energy_kwh(table.x), table.y, table.f, "charge_limit")

    @cached_property
    def discharge_limit_kw(self) -> Table2:
        """Largest discharging power over (energy, temperature) [kW over kWh, degrees C]."""
        table = self.discharge_limit_soc_kw
        return Table2(self.energy_kwh(table.x), table.y, table.f, "discharge_limit")


@dataclass(frozen=True)
class RoadLoad:
    """Propulsion: road load F = a + b*v + c*v^2 + m*g*grade, and drivetrain losses.

    Parameters
    ----------
    mass_kg : float
        Test mass [kg]; rolling coefficient is in ``a_n``.
    a_n, b_n_per_kmh, c_n_per_kmh2 : float
        Coast-down coefficients [N, N/(km/h), N/(km/h)^2].
    drive_efficiency, regen_efficiency : float
        Battery to wheel and wheel to battery, in (0, 1].
    regen_max_kw : float
        Largest braking power at the wheel that is recuperated [kW].
    factor : float
        Multiplies the battery-side propulsion power (calibration).
    heat_share : float
        Share of the drivetrain loss that reaches the battery loop.
    """

    mass_kg: float
    a_n: float
    b_n_per_kmh: float
    c_n_per_kmh2: float
    drive_efficiency: float
    regen_efficiency: float
    regen_max_kw: float
    factor: float
    heat_share: float


@dataclass(frozen=True)
class Vehicle:
    """A car: pack, road load, actuators and cabin.

    Parameters
    ----------
    name : str
        Preset name.
    pack : Pack
        The battery.
    road_load : RoadLoad
        Propulsion.
    heat_loss_kw_per_k : Table1
        Conductance battery to ambient over speed [kW/K over km/h]; at 0 when parked.
    heater_kw : float
        Largest electrical heater power (HVCH), battery and cabin together [kW].
    heater_battery_efficiency, heater_cabin_efficiency : float
        Heat per electrical power of the two heater paths.
    cooling_kw : float
        Largest electrical power of battery cooling (HVAC) [kW].
    cooling_cop : float
        Heat removed per electrical power.
    cooling_from_c : float
        Battery temperature below which the battery is not cooled: cooling never
        takes a step or a cell to an end below it [degrees C].
    heat_pump_kw : float
        Largest compressor power [kW]; 0: no heat pump.
    heat_pump_cop : Table1
        Coefficient of performance at vanishing power over battery temperature.
    heat_pump_droop_per_kw : float
        cop(T, P) = cop(T) * (1 - droop * P) [1/kW]; at full power at most a half, so that
        heat rises with power.
    cabin_heating_kw : Table1
        Heat demand of the cabin over ambient temperature [kW].
    cabin_cooling_kw : Table1
        Electrical power of cabin cooling over ambient temperature [kW].
    auxiliary_kw : float
        Constant consumers [kW].

    Raises
    ------
    InputError
        The heat pump's heat falls before its power is full: a heat would have two powers.
    """

    name: str
    pack: Pack
    road_load: RoadLoad
    heat_loss_kw_per_k: Table1
    heater_kw: float
    heater_battery_efficiency: float
    heater_cabin_efficiency: float
    cooling_kw: float
    cooling_cop: float
    cooling_from_c: float
    heat_pump_kw: float
    heat_pump_cop: Table1
    heat_pump_droop_per_kw: float
    cabin_heating_kw: Table1
    cabin_cooling_kw: Table1
    auxiliary_kw: float

    def __post_init__(self) -> None:
        """Check what every part of the model takes for granted."""
        if self.heat_pump_droop_per_kw * self.heat_pump_kw > LARGEST_DROOP:
            allowed = (
                f"at most {LARGEST_DROOP / self.heat_pump_kw:g} with heat_pump_kw "
                f"{self.heat_pump_kw:g}, so that heat rises with power"
            )
            raise InputError(
                self.name, "heat_pump_droop_per_kw", self.heat_pump_droop_per_kw, allowed
            )
