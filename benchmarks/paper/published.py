"""Owns what the paper publishes: its two tables and what it says of five cases. Nothing of ours.

Source: A. Hamednia, V. Hanson, J. Zhao, N. Murgovski, J. Forsman, M. Pourabdollah, V. Larsson,
J. Fredriksson, "Optimal Thermal Management and Charging of Battery Electric Vehicles over Long
Trips" (2022). Charged energy in kWh at a given charging and detour time; times in minutes.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "AMBIENT_C",
    "CASES",
    "ENERGY_AT_MIN",
    "ENERGY_KWH",
    "HEAT_PUMP_KW",
    "LEAST_TIME_MIN",
    "PRINTED_SAVING",
    "SWEEP_TIME_VALUE_PER_H",
    "Case",
    "saving",
]

AMBIENT_C = (-10.0, 0.0, 10.0)
"""Ambient temperatures; the battery starts there [degrees C]."""
HEAT_PUMP_KW = (0.0, 1.0, 3.0)
"""No heat pump, the smaller, the larger one [kW]."""
SWEEP_TIME_VALUE_PER_H = 40.0
"""Value of time of case D and of the sweep over ambient temperature [SEK/h]."""

ENERGY_AT_MIN = {-10.0: 28.0, 0.0: 22.0, 10.0: 16.0}
"""Charging and detour time of the energy table, by ambient temperature [min]."""
ENERGY_KWH = {
    (-10.0, 0.0): 38.4,
    (-10.0, 1.0): 34.1,
    (-10.0, 3.0): 32.7,
    (0.0, 0.0): 31.3,
    (0.0, 1.0): 25.2,
    (0.0, 3.0): 25.2,
    (10.0, 0.0): 28.0,
    (10.0, 1.0): 22.3,
    (10.0, 3.0): 22.3,
}
"""Charged energy at that time, by ambient temperature and heat pump [kWh]."""
LEAST_TIME_MIN = {
    (-10.0, 0.0): 25.9,
    (-10.0, 1.0): 24.2,
    (-10.0, 3.0): 23.5,
    (0.0, 0.0): 22.3,
    (0.0, 1.0): 15.5,
    (0.0, 3.0): 15.5,
    (10.0, 0.0): 15.8,
    (10.0, 1.0): 14.2,
    (10.0, 3.0): 14.2,
}
"""Least charging and detour time, by ambient temperature and heat pump [min]."""

PRINTED_SAVING = {
    "energy": {
        (-10.0, 1.0): 11.1,
        (-10.0, 3.0): 14.9,
        (0.0, 1.0): 19.4,
        (0.0, 3.0): 19.4,
        (10.0, 1.0): 18.4,
        (10.0, 3.0): 18.4,
    },
    "time": {
        (-10.0, 1.0): 6.5,
        (-10.0, 3.0): 9.2,
        (0.0, 1.0): 30.6,
        (0.0, 3.0): 30.6,
        (10.0, 1.0): 10.1,
        (10.0, 3.0): 10.1,
    },
}
"""Savings against no heat pump as printed in the two tables [%]. At 10 C the energy's does not
follow from the energies beside it, which give 20.4 %."""


def saving(table: dict[tuple[float, float], float], ambient_c: float, heat_pump_kw: float) -> float:
    """Return the saving against no heat pump [%].

    Examples
    --------
    >>> round(saving(ENERGY_KWH, -10.0, 3.0), 1)
    14.8
    """
    without = table[ambient_c, 0.0]
    return 100.0 * (without - table[ambient_c, heat_pump_kw]) / without


@dataclass(frozen=True)
class Case:
    """One of the cases at -10 C that the paper describes.

    Parameters
    ----------
    name : str
        Letter.
    aim : {"energy", "time", "cost"}
        Least energy, least charging and detour time, or least cost at a value of time.
    heat_pump_kw : float
        Size [kW].
    stops : tuple of int
        Chargers used, by index: the paper's numbers less one.
    says : str
        What the paper says of the trajectory.
    """

    name: str
    aim: str
    heat_pump_kw: float
    stops: tuple[int, ...]
    says: str


CASES = (
    Case("A", "energy", 0.0, (1, 2), "no battery heating; the battery ends at 25 to 30 C"),
    Case("B", "energy", 1.0, (1, 2), "no battery heating; the heat pump is off just before each "
         "stop and in the first part of it"),
    Case("C", "energy", 3.0, (1,), "the heater warms the battery before the stop and in its first "
         "minutes; the battery falls below 0 C towards the end"),
    Case("D", "cost", 1.0, (1,), "one stop"),
    Case("E", "time", 1.0, (1, 2), "the heater warms the battery to about 25 C before the stops; "
         "heater at full power and heat pump for the cabin while charging"),
)  # fmt: skip
"""All at -10 C; the last by name is least time."""
