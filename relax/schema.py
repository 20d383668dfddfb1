"""Owns the shape of the TOML files: names, types, ranges. Knows nothing of the physics.

Points are pairs ``[x, y]``; units are in the field names or stated in the
descriptions, which also serve the error messages and the JSON Schema (class
docstrings too, hence the example here).

Examples
--------
>>> curve = {"curve_kw": [[0.0, 120.0], [1.0, 20.0]], "temperature_factor": [[-40, 0.1], [60, 1]]}
>>> import json
>>> LimitProduct.model_validate_json(json.dumps(curve)).curve_kw[1]
(1.0, 20.0)
>>> sorted(LimitTable.model_fields), "vehicle" in TripFile.model_fields
(['power_kw', 'soc', 'temperature_c'], True)
>>> VehicleFile.model_fields["heater_kw"].description
'largest heater power, battery and cabin, kW'
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["LimitProduct", "LimitTable", "TripFile", "VehicleFile"]

LARGEST = 1e9
"""Largest magnitude of any number: beyond it is a slip, and arithmetic might overflow."""

Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
# with a range that no car or charger leaves, to catch other units: J/K, t, W, mAh
HeatCapacity = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
Mass = Annotated[float, Field(ge=100, le=100_000, allow_inf_nan=False)]
Rating = Annotated[float, Field(gt=0, le=10_000, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Efficiency = Annotated[float, Field(ge=0.01, le=1, allow_inf_nan=False)]
Celsius = Annotated[float, Field(ge=-60, le=100, allow_inf_nan=False)]
Points = Annotated[list[tuple[Finite, Finite]], Field(min_length=2)]
Curve = Points | Finite
# without control characters: names are printed, and a terminal would obey some of them
Name = Annotated[str, Field(min_length=1, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]


def _say(description: str, **more: object) -> object:
    """Return a field with a description: the unit and meaning shown to users."""
    return Field(description=description, **more)  # type: ignore[call-overload]


class Strict(BaseModel):
    """Frozen, no unknown keys, no silent conversion of strings to numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class LimitTable(Strict):
    """Power over SoC (rows) and battery temperature (columns)."""

    soc: Annotated[list[Share], _say("state of charge of the rows", min_length=2)]
    temperature_c: Annotated[list[Celsius], _say("degrees C of the columns", min_length=2)]
    power_kw: Annotated[list[list[NonNegative]], _say("kW, one row per SoC")]


class LimitProduct(Strict):
    """Power as a curve over SoC times a factor over battery temperature."""

    curve_kw: Annotated[Points, _say("points [soc, kW]")]
    temperature_factor: Annotated[Points, _say("points [degrees C, factor]")]


class VehicleFile(Strict):
    """A vehicle preset. A map may be a number (constant) instead of points."""

    name: Annotated[Name, _say("name for reports")]
    source: Annotated[str, _say("where the figures come from")]
    # pack
    capacity_ah: Annotated[Rating, _say("charge between SoC 0 and 1, Ah")]
    ocv_v: Annotated[Curve, _say("open-circuit voltage: points [soc, V] or a number")]
    resistance_ohm: Annotated[Curve, _say("pack resistance: points [degrees C, ohm] or a number")]
    charge_limit: Annotated[
        LimitTable | LimitProduct,
        _say("a table {soc, temperature_c, power_kw} or {curve_kw, temperature_factor}"),
    ]
    discharge_limit: Annotated[
        LimitTable | LimitProduct,
        _say("a table {soc, temperature_c, power_kw} or {curve_kw, temperature_factor}"),
    ]
    heat_capacity_kwh_per_k: Annotated[HeatCapacity, _say("lumped heat capacity, kWh/K")]
    temperature_min_c: Annotated[Celsius, _say("least battery temperature, degrees C")]
    temperature_max_c: Annotated[Celsius, _say("largest battery temperature, degrees C")]
    heat_loss_kw_per_k: Annotated[
        Curve, _say("battery to ambient: points [km/h, kW/K] from 0 km/h (parked), or a number")
    ]
    # actuators
    heater_kw: Annotated[NonNegative, _say("largest heater power, battery and cabin, kW")]
    heater_battery_efficiency: Annotated[Efficiency, _say("heat per power, battery path")]
    heater_cabin_efficiency: Annotated[Efficiency, _say("heat per power, cabin path")] = 1.0
    cooling_kw: Annotated[NonNegative, _say("largest battery cooling power, kW electrical")]
    cooling_cop: Annotated[Positive, _say("heat removed per cooling power")]
    cooling_from_c: Annotated[
        Celsius, _say("battery temperature below which the battery is not cooled")
    ] = 25.0
    heat_pump_kw: Annotated[NonNegative, _say("largest compressor power, kW; 0: none")]
    heat_pump_cop: Annotated[
        Curve | None, _say("points [battery degrees C, CoP at vanishing power] or a number")
    ] = None  # may be left out when heat_pump_kw is 0
    heat_pump_droop_per_kw: Annotated[NonNegative, _say("CoP falls by this share per kW")] = 0.0
    # cabin and auxiliaries
    cabin_heating_kw: Annotated[
        Curve, _say("heat demand: points [ambient degrees C, kW heat] or a number")
    ]
    cabin_cooling_kw: Annotated[
        Curve, _say("cabin cooling: points [ambient degrees C, kW electrical] or a number")
    ]
    auxiliary_kw: Annotated[NonNegative, _say("constant consumers, kW")]
    # propulsion
    mass_kg: Annotated[Mass, _say("test mass, kg")]
    road_load_a_n: Annotated[NonNegative, _say("coast-down constant, N")]
    road_load_b_n_per_kmh: Annotated[Finite, _say("coast-down linear term, N/(km/h)")]
    road_load_c_n_per_kmh2: Annotated[NonNegative, _say("coast-down square term, N/(km/h)^2")]
    drive_efficiency: Annotated[Efficiency, _say("battery to wheel")]
    regen_efficiency: Annotated[Efficiency, _say("wheel to battery")]
    regen_max_kw: Annotated[NonNegative, _say("largest recuperated power at the wheel, kW")]
    propulsion_factor: Annotated[Positive, _say("multiplies computed propulsion power")] = 1.0
    drivetrain_heat_share: Annotated[Share, _say("share of drivetrain loss reaching the battery")]


class RouteSection(Strict):
    """The road: a shipped preset or a CSV file beside the trip.

    ``start_km`` and ``end_km`` cut the file; every other position in a trip
    counts from the cut's start. Ambient points are linear in between and held
    beyond the first and last.
    """

    preset: Annotated[str | None, _say("name of a shipped route")] = None
    file: Annotated[str | None, _say("CSV file, relative to the trip file")] = None
    start_km: Annotated[NonNegative, _say("where the trip starts in the file, km")] = 0.0
    end_km: Annotated[Positive | None, _say("where the trip ends in the file, km")] = None
    sample_km: Annotated[Positive | None, _say("average in time over samples of this, km")] = None
    ambient_c: Annotated[
        Celsius | Annotated[list[tuple[NonNegative, Celsius]], Field(min_length=1)] | None,
        _say("degrees C from -60 to 100: a number or points [km, degrees C]"),
    ] = None


class ChargerSection(Strict):
    """One charger; a detour is a number (half in, half out) or a pair [in, out]."""

    name: Annotated[Name, _say("unique name")]
    position_km: Annotated[NonNegative, _say("km from the start of the trip")]
    power_kw: Annotated[Rating, _say("rated grid power, kW")]
    price_per_kwh: Annotated[Finite, _say("currency per kWh from the grid")]
    detour_min: Annotated[
        NonNegative | tuple[NonNegative, NonNegative],
        _say("minutes >= 0: a number, half in and half out, or a pair [in, out]"),
    ] = 5.0
    detour_kwh: Annotated[
        NonNegative | tuple[NonNegative, NonNegative],
        _say("kWh >= 0: a number, half in and half out, or a pair [in, out]"),
    ] = 0.0
    occupancy_free_min: Annotated[NonNegative, _say("dwell without occupancy cost, min")] = 0.0
    occupancy_price_per_min: Annotated[NonNegative, _say("currency per min beyond it")] = 0.0
    stop_penalty: Annotated[NonNegative, _say("fixed cost of a stop, currency")] = 0.0
    max_dwell_min: Annotated[Positive, _say("longest dwell, min")] = 240.0
    current_a: Annotated[Positive | None, _say("current limit, A")] = None
    curve: Annotated[Points | None, _say("the charger's own limit: points [soc, kW]")] = None


class ObjectiveSection(Strict):
    """What is minimised beside the energy cost."""

    time_value_per_h: Annotated[NonNegative, _say("currency per hour of charging and detour")]


class StartSection(Strict):
    """State at departure."""

    soc: Annotated[Share, _say("state of charge, 0 to 1")]
    battery_temperature_c: Annotated[
        Celsius | None, _say("degrees C; the ambient temperature at km 0 when left out")
    ] = None


class EndSection(Strict):
    """State at the destination."""

    soc_min: Annotated[Share, _say("least state of charge, 0 to 1")]


class LimitsSection(Strict):
    """Limits on the way; ``soc_min`` a number or points [km, soc], held beyond the ends."""

    soc_min: Annotated[
        Share | Annotated[list[tuple[NonNegative, Share]], Field(min_length=1)],
        _say("state of charge from 0 to 1: a number or points [km, soc]"),
    ] = 0.05
    soc_max: Annotated[Share, _say("largest state of charge after charging, 0 to 1")] = 1.0
    temperature_max_c: Annotated[Celsius | None, _say("tightens the vehicle's limit")] = None
    temperature_min_c: Annotated[Celsius | None, _say("tightens the vehicle's limit")] = None
    stop_time_h: Annotated[
        NonNegative | None,
        _say("most charging and detour time of the whole trip, h; no limit when left out"),
    ] = None


class GridSection(Strict):
    """How finely the trip is transcribed."""

    step_km: Annotated[float, _say("longest driving step, km", ge=0.05, allow_inf_nan=False)] = 4.0
    cells: Annotated[int, _say("charging cells per stop, 2 to 200", ge=2, le=200)] = 12


class TripFile(Strict):
    """A trip."""

    name: Annotated[Name, _say("name for reports")]
    description: Annotated[str, _say("free text")] = ""
    currency: Annotated[Name, _say("currency of every cost")]
    vehicle: Annotated[
        dict[str, object], _say("preset or file, and any vehicle field to replace in it")
    ]
    route: Annotated[RouteSection, _say("the road")]
    charger: Annotated[list[ChargerSection], _say("chargers, in any order")] = []
    objective: Annotated[ObjectiveSection, _say("what is minimised")]
    start: Annotated[StartSection, _say("state at departure")]
    end: Annotated[EndSection, _say("state at the destination")]
    limits: Annotated[LimitsSection, _say("limits on the way")] = LimitsSection()
    grid: Annotated[GridSection, _say("transcription")] = GridSection()
    format: Annotated[Literal[1], _say("version of this format")] = 1
