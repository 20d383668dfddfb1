"""Owns the presets of real cars: which figure serves which field. Knows nothing of file formats.

No car's maps are published as a set. Each map is taken from the best open
source for *a* cell or car of its kind and scaled to the pack; the field
comments say which part is measured, computed by a model, or assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.data.emit import Field, points, rounded
from benchmarks.data.figures import (
    TEST_AUXILIARY_KW,
    WALL_TO_BATTERY,
    drive_efficiency,
    heat_pump_cop,
    i3_ratio,
    internal_power_kw,
    lfp_ratio,
    ocv_v,
    source_of,
    temperature_factor,
)

__all__ = ["CARS", "Car", "car_preset"]

Array = npt.NDArray[np.float64]

NMC_MOHM_AH = source_of("pulse_resistance.csv", "Mohtat2020")[0][0]
"""Cell resistance times capacity at 25 C: 30 s pulse at SoC 0.5."""

I3_MOHM_AH = 44.5
"""The BMW i3's measured 71.2 mohm * 60 Ah / 96 cells."""

TEMPERATURE_C = np.arange(-30.0, 50.1, 2.5)


@dataclass(frozen=True)
class Car:
    """What distinguishes one car from another.

    Parameters
    ----------
    name, title : str
        Preset name and what it stands for.
    chemistry : {"nmc", "lfp"}
        Chooses OCV and resistance shape.
    series : int
        Cells in series.
    stated_kwh : float
        Energy between SoC 0 and 1 as stated by ``energy_origin``.
    capacity_ah : float or None
        Published; None: follows from ``stated_kwh`` and the OCV.
    heat_capacity_kj_per_k, conductance_w_per_k : float
        Of the pack; conductance at 100 km/h.
    """

    name: str
    title: str
    chemistry: str
    series: int
    stated_kwh: float
    energy_origin: str
    capacity_ah: float | None
    heat_capacity_kj_per_k: float
    heat_capacity_origin: str
    conductance_w_per_k: float
    conductance_origin: str
    heater_kw: float
    heat_pump_kw: float
    cabin_scale: float
    motor_kw: float
    motor_origin: str
    heat_share: float
    curve_origin: str


CARS = (
    Car(
        "polestar-2-dual",
        "Polestar 2 Dual Motor (78 kWh, NMC)",
        "nmc",
        108,
        78.0,
        "Published for this pack: 195 Ah (Hamednia et al. 2022), sold as 78 kWh, 108 in series. "
        "SoC counts the whole pack; the car shows about 75 kWh of it.",
        195.0,
        375.0,
        "Published for this 195 Ah pack by Hamednia et al. (2022): 375 kJ/K. The calibrated packs "
        "of FASTSim 3.1.0 (2.9-3.3 kJ/K per kWh) would give about 230 kJ/K.",
        50.0,
        "Assumed: 10 W/K parked; 50 W/K at 100 km/h, between FASTSim 3.1.0's Model 3 (47.7) and "
        "Bolt (58.3).",
        7.0,
        2.0,
        1.0,
        300.0,
        "rated motor power",
        0.30,
        "entry Polestar 2 (2020, 150 kW)",
    ),
    Car(
        "tesla-model-3-rwd",
        "Tesla Model 3 RWD (54 kWh, LFP)",
        "lfp",
        106,
        54.0,
        "54 kWh: FASTSim 2.1.5, 2022 Tesla Model 3 RWD. 106 in series assumed.",
        None,
        158.336,
        "FASTSim 3.1.0, 2022 Tesla Model 3 RWD: 158.3 kJ/K, calibrated by NREL (Apache-2.0).",
        47.688,
        "47.7 W/K at 100 km/h: FASTSim 3.1.0, same car, constant there; 10 W/K parked assumed.",
        5.0,
        3.0,
        1.0,
        201.0,
        "FASTSim 2.1.5, battery power",
        0.60,
        "entry Model 3 SR+; the source does not say whether that car's pack was NCA or LFP",
    ),
    Car(
        "audi-e-tron-55",
        "Audi e-tron 55 quattro (86.5 kWh usable, NMC)",
        "nmc",
        108,
        86.5,
        "86.5 kWh usable (chargeprice entry); 108 in series assumed. SoC counts the usable part, "
        "the OCV is that of a whole cell.",
        None,
        278.0,
        "Computed: 95 kWh gross (assumed) times 2.93 kJ/K per kWh of FASTSim 3.1.0's Model 3.",
        65.0,
        "Assumed: 10 W/K parked; 65 W/K at 100 km/h (FASTSim 3.1.0's Bolt 58.3, larger pack).",
        6.0,
        3.0,
        1.3,
        300.0,
        "assumed, from the rated motor power",
        0.30,
        "entry e-tron 55 (2019, 155 kW)",
    ),
)
"""Every car that is written."""


def _resistance(car: Car, capacity_ah: float) -> tuple[Array, str]:
    if car.chemistry == "lfp":
        at_25 = I3_MOHM_AH / 1000 * car.series / capacity_ah
        return at_25 * lfp_ratio(TEMPERATURE_C), (
            f"Shape measured: Sony US26650FTC1 LFP cell at 10 / 25 / 40 C, SoC 0.5, mean of charge "
            "and discharge (SimSES, BSD-3-Clause), Arrhenius between and beyond (below 10 C an "
            f"extrapolation). Level assumed: {1000 * at_25:.1f} mohm at 25 C, {I3_MOHM_AH} mohm Ah "
            "per cell as the BMW i3's large cells; the small Sony cell itself has 139 mohm Ah."
        )
    at_25 = NMC_MOHM_AH / 1000 * car.series / capacity_ah
    return at_25 * i3_ratio(TEMPERATURE_C), (
        "Shape measured: BMW i3 pack, medians of 20 s windows in real trips (doi:10.21227/"
        "6jr9-5235, CC BY 4.0 as third parties state), smoothed 0..30 C, continued by the "
        f"Arrhenius fit (27.6 kJ/mol). Level computed: {1000 * at_25:.1f} mohm at 25 C, 30 s "
        "pulse of PyBaMM's Mohtat2020 cell (58.9 mohm Ah). The spread is wide: 46 (Ecker2015) to "
        "197 (OKane2022), the i3 itself 44.5."
    )


def car_preset(car: Car) -> tuple[str, list[Field]]:
    """Return header and fields of a preset.

    Examples
    --------
    >>> car_preset(CARS[0])[1][0].value
    'polestar-2-dual'
    """
    cell = ocv_v(car.chemistry)
    soc, volt = np.array(cell).T
    mean_v = float(np.sum(0.5 * (volt[1:] + volt[:-1]) * np.diff(soc)))
    capacity = car.capacity_ah or round(1000 * car.stated_kwh / (car.series * mean_v), 1)
    energy = capacity * car.series * mean_v / 1000
    resistance, resistance_origin = _resistance(car, capacity)
    a, b, c, mass, wall = source_of("road_load.csv", car.name)[0][:5]
    efficiency = drive_efficiency(car.name)
    curve = np.array(source_of("dc_curves.csv", car.name))
    pack_v = car.series * np.interp(curve[:, 0], soc, volt)
    r_warm = float(np.interp(30.0, TEMPERATURE_C, resistance))
    limit = internal_power_kw(curve[:, 1], pack_v, r_warm)
    cell_origin = (
        "Measured: Sony US26650FTC1 LFP cell (SimSES, BSD-3-Clause)"
        if car.chemistry == "lfp"
        else "Computed: PyBaMM 26.10.1.1 (BSD-3-Clause), Mohtat2020 NMC532/graphite cell, 25 C"
    )
    source = (
        f"{car.title}: EPA test car list 2022 (road load), chargeprice/open-ev-data (DC curve), "
        "cell maps of comparable cells; see the comments of every field"
    )
    header = (
        f"{car.name}: {car.title}.\n"
        "Written by `python -m benchmarks.data.vehicles` from benchmarks/data/cars.py.\n\n"
        "A car of this kind, not this car: road load and DC curve belong to it, the pack maps to "
        "comparable cells, the thermal actuators are assumptions. None of it comes from the maker."
    )
    parked_to_100 = car.conductance_w_per_k / 1000
    slope = (parked_to_100 - 0.010) / 100
    fields = [
        Field("name", car.name),
        Field("source", source),
        Field("capacity_ah", capacity, f"{car.energy_origin} Here: {energy:.1f} kWh."),
        Field(
            "ocv_v",
            points(soc, car.series * volt),
            f"{cell_origin}, times {car.series}, thinned.",
        ),
        Field("resistance_ohm", points(TEMPERATURE_C, resistance), resistance_origin),
        Field(
            "heat_capacity_kwh_per_k",
            rounded(car.heat_capacity_kj_per_k / 3600),
            car.heat_capacity_origin,
        ),
        Field("temperature_min_c", -30.0, "Assumed."),
        Field("temperature_max_c", 45.0),
        Field(
            "heat_loss_kw_per_k",
            points([0.0, 100.0, 200.0], [0.010, parked_to_100, parked_to_100 + 100 * slope]),
            car.conductance_origin,
        ),
        Field(
            "heater_kw",
            car.heater_kw,
            "Assumed, but for 0.87 (Hamednia et al. 2022): heater, cooling and its CoP.",
        ),
        Field("heater_battery_efficiency", 0.87),
        Field("heater_cabin_efficiency", 1.0),
        Field("cooling_kw", 3.0),
        Field("cooling_cop", 2.0),
        Field("heat_pump_kw", car.heat_pump_kw, "Assumed."),
        Field(
            "heat_pump_cop",
            heat_pump_cop(),
            "Computed: R1234yf cycle, isentropic efficiency 0.65 (CoolProp 8.0.0, MIT); "
            "evaporation 7.5 K below the battery, condensation 50 and 55 C averaged in 1/CoP; "
            "1/CoP straight below -12.5 C, constant above 37.5 C (assumed). The droop is assumed.",
        ),
        Field("heat_pump_droop_per_kw", 0.03),
        Field(
            "cabin_heating_kw",
            points([-30.0, 22.0, 50.0], [0.063 * car.cabin_scale * 52, 0.0, 0.0]),
            f"Measured slope: BMW i3, warmed up, 0.063 kW/K (+- 0.014) at -3..9 C ambient, here "
            f"times {car.cabin_scale:g} (assumed), 22 C cabin, straight beyond. No fresh-air "
            "demand added: full fresh air would need about 0.1 kW/K more.",
        ),
        Field(
            "cabin_cooling_kw",
            points([-30.0, 22.0, 50.0], [0.0, 0.0, 2.8 * car.cabin_scale]),
            "Assumed: none below 22 C, then straight.",
        ),
        Field("auxiliary_kw", 0.5, "Assumed, as in Hamednia et al. (2022)."),
        Field(
            "mass_kg",
            mass,
            "Measured: EPA 2022 test car list, coast-down coefficients and test mass (US public "
            "domain), converted from N/(m/s) and N/(m/s)^2.",
        ),
        Field("road_load_a_n", a),
        Field("road_load_b_n_per_kmh", b / 3.6),
        Field("road_load_c_n_per_kmh2", c / 3.6**2),
        Field(
            "drive_efficiency",
            efficiency,
            f"Computed: the one efficiency, both ways, that meets EPA's highway test ({wall:g} "
            f"kWh/100 km at the wall) with {WALL_TO_BATTERY:g} wall to battery and "
            f"{TEST_AUXILIARY_KW:g} kW of consumers (assumed). Regeneration and the share of the "
            "drivetrain loss that reaches the battery are assumed.",
        ),
        Field("regen_efficiency", efficiency),
        Field("regen_max_kw", 100.0),
        Field("propulsion_factor", 1.0),
        Field("drivetrain_heat_share", car.heat_share),
        Field(
            "charge_limit",
            {
                "curve_kw": points(curve[:, 0], limit),
                "temperature_factor": temperature_factor(),
            },
            f"Curve measured by the public: chargeprice/open-ev-data (MIT), {car.curve_origin}; "
            "pack temperature unknown, taken as warm. Converted from charger to internal power "
            "with R at 30 C. Factor computed: median of three lithium-plating models (PyBaMM) up "
            "to 25 C; assumed below -10 C (same slope), 1 from 25 to 40 C, falling above.",
        ),
        Field(
            "discharge_limit",
            {
                "curve_kw": points(
                    [0.0, 0.05, 0.2, 1.0],
                    [0.15 * car.motor_kw, 0.5 * car.motor_kw, car.motor_kw, car.motor_kw],
                ),
                "temperature_factor": points(
                    [-30.0, -10.0, 10.0, 20.0, 50.0], [0.2, 0.5, 0.9, 1, 1]
                ),
            },
            f"Assumed: {car.motor_kw:g} kW ({car.motor_origin}), less when cold or nearly empty. "
            "It does not bind at motorway speeds.",
        ),
    ]
    return header, fields
