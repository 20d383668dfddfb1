"""Owns the values a plan is made of: controls, and the trajectory they cause.

``Controls`` is what a car executes; ``Trajectory`` what the transcription says
happens then. Both are frozen values without behaviour. Knows nothing of how
either was found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

__all__ = ["Controls", "StopControls", "StopTrajectory", "Trajectory"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class StopControls:
    """What the car does at one stop; arrays of shape (K,), one value per cell.

    Parameters
    ----------
    energy_kwh : float
        Internal energy to charge, W [kWh]; each cell is W/K.
    power_kw : ndarray
        Planned internal charging power; the battery's and the charger's limits
        clip it (``inf``: as fast as they allow) [kW].
    heater_kw, cooling_kw, heat_pump_kw : ndarray
        Electrical powers of battery heater, battery cooling and heat pump [kW].
    """

    energy_kwh: float
    power_kw: Array
    heater_kw: Array
    cooling_kw: Array
    heat_pump_kw: Array


@dataclass(frozen=True)
class Controls:
    """What the car does on the whole trip; arrays of shape (n,), one value per driving step.

    Parameters
    ----------
    heater_kw, cooling_kw, heat_pump_kw : ndarray
        Electrical powers of battery heater, battery cooling and heat pump [kW].
    stops : tuple of StopControls
        One per stop of the instance.
    """

    heater_kw: Array
    cooling_kw: Array
    heat_pump_kw: Array
    stops: tuple[StopControls, ...]

    def heated_as(self, done: Trajectory) -> Controls:
        """Return these controls with the heater's powers of a trajectory: what it was held to.

        Parameters
        ----------
        done : Trajectory
            What these controls caused.
        """
        stops = zip(self.stops, done.stops, strict=True)
        return replace(
            self,
            heater_kw=done.heater_kw,
            stops=tuple(replace(c, heater_kw=s.heater_kw) for c, s in stops),
        )


@dataclass(frozen=True)
class StopTrajectory:
    """One stop as simulated; arrays of shape (K,) unless stated.

    Parameters
    ----------
    energy_kwh, temperature_c : ndarray, shape (K + 1,)
        State at the cell borders, detours excluded [kWh, degrees C].
    dwell_h : ndarray
        Time spent in every cell [h].
    power_kw : ndarray
        Internal charging power, >= 0 [kW].
    grid_kwh, loss_kwh : ndarray
        Energy from the grid and Joule loss [kWh].
    heater_kw, cooling_kw, heat_pump_kw, pump_heat_kw, cabin_heater_kw : ndarray
        Powers as applied after clipping [kW]; ``pump_heat_kw`` is heat to the cabin.
    limit_kw : ndarray
        Battery charge limit [kW].
    """

    energy_kwh: Array
    temperature_c: Array
    dwell_h: Array
    power_kw: Array
    grid_kwh: Array
    loss_kwh: Array
    heater_kw: Array
    cooling_kw: Array
    heat_pump_kw: Array
    pump_heat_kw: Array
    cabin_heater_kw: Array
    limit_kw: Array


@dataclass(frozen=True)
class Trajectory:
    """A simulated trip on the transcription; arrays of shape (n,) unless stated.

    Parameters
    ----------
    energy_kwh, temperature_c : ndarray, shape (n + 1,)
        State on arrival at every node, before a stop there [kWh, degrees C].
    energy_start_kwh, temperature_start_c : ndarray, shape (n,)
        State at the start of every step, after a stop there.
    power_kw : ndarray
        Internal battery power, > 0 discharging [kW].
    loss_kw : ndarray
        Joule loss [kW].
    brake_kw : ndarray
        Recuperation given up because the battery cannot take it [kW].
    heater_kw, cooling_kw, heat_pump_kw, pump_heat_kw, cabin_heater_kw : ndarray
        Powers as applied after clipping [kW].
    stops : tuple of StopTrajectory
        One per stop.
    final_energy_kwh, final_temperature_c : float
        State at the end, after a stop at the destination.
    cost : float
        Objective, fixed cost included [currency].
    violation : ndarray, shape (4,)
        Largest violation of the energy limits [kWh], the temperature limits [K], the
        discharge limit [kW] and the longest dwells, of a stop and of all together [h];
        zeros: feasible.
    """

    energy_kwh: Array
    temperature_c: Array
    energy_start_kwh: Array
    temperature_start_c: Array
    power_kw: Array
    loss_kw: Array
    brake_kw: Array
    heater_kw: Array
    cooling_kw: Array
    heat_pump_kw: Array
    pump_heat_kw: Array
    cabin_heater_kw: Array
    stops: tuple[StopTrajectory, ...]
    final_energy_kwh: float
    final_temperature_c: float
    cost: float
    violation: Array
