"""Owns loading: names, files and overrides in, checked values out.

Finds and reads the documents and leaves their meaning to ``vehicle_file``,
``route_file`` and ``trip_file``. Knows nothing of grids, programs or solvers.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from relax.document import OVERRIDE, Origin, one_line, one_of, read_toml, with_overrides
from relax.errors import InputError
from relax.propulsion import Profile
from relax.route_file import read_profile
from relax.schema import TripFile, VehicleFile
from relax.trip import Trip
from relax.trip_file import make_trip
from relax.validation import validate
from relax.vehicle import Vehicle
from relax.vehicle_file import make_vehicle

__all__ = [
    "check_keys",
    "load_trip",
    "load_vehicle",
    "shipped_routes",
    "shipped_trips",
    "shipped_vehicles",
    "trip_schema",
    "vehicle_schema",
]

OPEN = {"vehicle": {"preset", "file", *VehicleFile.model_fields}}
"""Names in sections that the schema leaves open."""
SUFFIX = {"trips": ".toml", "vehicles": ".toml", "routes": ".csv"}


def _shipped(kind: str) -> list[str]:
    folder, end = files("relax") / "data" / kind, SUFFIX[kind]
    return sorted(f.name.removesuffix(end) for f in folder.iterdir() if f.name.endswith(end))


def shipped_trips() -> list[str]:
    """Return the names of the trips that come with the package.

    Examples
    --------
    >>> isinstance(shipped_trips(), list)
    True
    """
    return _shipped("trips")


def shipped_vehicles() -> list[str]:
    """Return the names of the vehicles that come with the package.

    Examples
    --------
    >>> "paper-2022" in shipped_vehicles()
    True
    """
    return _shipped("vehicles")


def shipped_routes() -> list[str]:
    """Return the names of the routes that come with the package.

    Examples
    --------
    >>> isinstance(shipped_routes(), list)
    True
    """
    return _shipped("routes")


def vehicle_schema() -> dict[str, Any]:
    """Return the JSON Schema of a vehicle file.

    Examples
    --------
    >>> "ocv_v" in vehicle_schema()["required"]
    True
    """
    return VehicleFile.model_json_schema()


def trip_schema() -> dict[str, Any]:
    """Return the JSON Schema of a trip file, the vehicle's fields included.

    Examples
    --------
    >>> schema = trip_schema()
    >>> "heat_pump_kw" in schema["properties"]["vehicle"]["properties"]
    True
    """
    schema, vehicle = TripFile.model_json_schema(), vehicle_schema()
    schema["$defs"] |= vehicle["$defs"]
    names = {"preset": shipped_vehicles(), "file": None}
    choice = {k: {"type": "string"} | ({"enum": v} if v else {}) for k, v in names.items()}
    schema["properties"]["vehicle"] = {
        "description": TripFile.model_fields["vehicle"].description,
        "type": "object",
        "properties": choice | vehicle["properties"],
        "additionalProperties": False,
        "oneOf": [{"required": ["preset"]}, {"required": ["file"]}],
    }
    return schema


def _find(name: str | Path, kind: str) -> tuple[Traversable, str]:
    """File that a shipped name or a path means, and how to call it in errors."""
    text, end = os.fspath(name), SUFFIX[kind]
    known = _shipped(kind)
    if isinstance(name, str) and text in known:
        return files("relax") / "data" / kind / f"{text}{end}", f"{text} (shipped)"
    if os.path.isfile(text):
        return Path(text), one_line(text)
    stem = Path(text).name.removesuffix(end)
    allowed = f"a {end} file that exists, or a shipped name: {one_of(known, stem)}"
    raise InputError(text, kind.removesuffix("s"), text, allowed)


def _find_in(
    origin: Origin, section: str, preset: object, file: object, folder: Path | None
) -> tuple[Traversable, str]:
    """File that the ``preset`` or ``file`` of a trip's section means."""
    kind = f"{section}s"
    known = _shipped(kind)
    for field, value in (("preset", preset), ("file", file)):
        if value is not None and not isinstance(value, str):
            raise origin.error(f"{section}.{field}", value, "a string")
    if preset is None and file is None:
        allowed = f"preset or file; preset: {one_of(known)}"
        raise origin.error(f"{section}.preset", None, allowed)
    if preset is not None and file is not None:
        raise origin.error(f"{section}.file", file, f"either preset ({preset!r}) or file, not both")
    if preset is not None:
        if preset not in known:
            raise origin.error(f"{section}.preset", preset, one_of(known, preset))
        return files("relax") / "data" / kind / f"{preset}{SUFFIX[kind]}", f"{preset} (shipped)"
    path = Path(folder or "", str(file))
    shown = one_line(str(path))
    if not os.path.isfile(path):
        allowed = f"a {SUFFIX[kind]} file that exists, beside the trip (looked for {shown})"
        raise origin.error(f"{section}.file", file, allowed)
    return path, shown


def load_vehicle(vehicle: str | Path, overrides: Mapping[str, object] | None = None) -> Vehicle:
    """Return a vehicle, checked.

    Parameters
    ----------
    vehicle : str or Path
        Name of a shipped vehicle, or a TOML file.
    overrides : mapping of str to object, optional
        Fields to replace before checking, e.g. ``{"heat_pump_kw": 3}``.

    Raises
    ------
    InputError
        Names file, field, value and what is allowed.

    Examples
    --------
    >>> load_vehicle("paper-2022", {"heat_pump_kw": 3}).heat_pump_kw
    3.0
    """
    file, source = _find(vehicle, "vehicles")
    document, replaced = with_overrides(read_toml(file, source), overrides or {}, VehicleFile)
    origin = Origin(source, replaced)
    return make_vehicle(validate(VehicleFile, document, origin), origin)


def check_keys(trip: str | Path, overrides: Mapping[str, object]) -> None:
    """Raise if a key of overrides does not exist in a trip; values are not looked at.

    Parameters
    ----------
    trip : str or Path
        Name of a shipped trip, or a TOML file.
    overrides : mapping of str to object
        As for ``load_trip``.

    Raises
    ------
    InputError
        Names the key and which there are.

    Examples
    --------
    >>> check_keys("paper-400km", {"route.ambient": 3})
    Traceback (most recent call last):
        ...
    relax.errors.InputError: override: route.ambient: 3; allowed: did you mean 'route.ambient_c'?...
    """
    file, source = _find(trip, "trips")
    with_overrides(read_toml(file, source), overrides, TripFile, OPEN)


def load_trip(trip: str | Path, overrides: Mapping[str, object] | None = None) -> Trip:
    """Return a trip, checked.

    Parameters
    ----------
    trip : str or Path
        Name of a shipped trip, or a TOML file.
    overrides : mapping of str to object, optional
        Dotted keys to set before checking: ``route.ambient_c``,
        ``vehicle.heat_pump_kw``, ``charger.NAME.power_kw`` ... A file name given
        here counts from the working directory.

    Raises
    ------
    InputError
        Names file, field, value and what is allowed.

    Examples
    --------
    >>> load_trip("nowhere")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    relax.errors.InputError: trip: 'nowhere'; allowed: ...
    """
    file, source = _find(trip, "trips")
    folder = file.parent if isinstance(file, Path) else None
    given = dict(overrides or {})
    document, replaced = with_overrides(read_toml(file, source), given, TripFile, OPEN)
    _settle_choice(document, given)
    origin = Origin(source, replaced)
    spec = validate(TripFile, document, origin)
    car_spec, car_origin = _vehicle_document(spec, origin, folder)
    return make_trip(spec, origin, car_spec, car_origin, _profile(spec, origin, folder))


def _settle_choice(document: dict[str, Any], overrides: Mapping[str, object]) -> None:
    """Let an override of preset or file replace the other; count files from here."""
    for section in ("vehicle", "route"):
        for key, other in (("preset", "file"), ("file", "preset")):
            if f"{section}.{key}" in overrides:
                table = document[section]
                if f"{section}.{other}" not in overrides:
                    table.pop(other, None)
                if key == "file" and isinstance(table[key], str | Path):
                    table[key] = str(Path(table[key]).absolute())


def _vehicle_document(
    spec: TripFile, origin: Origin, folder: Path | None
) -> tuple[VehicleFile, Origin]:
    """Vehicle document with the trip's own fields in it, and where each came from."""
    fields = dict(spec.vehicle)
    preset, path = fields.pop("preset", None), fields.pop("file", None)
    for name, value in fields.items():
        if name not in VehicleFile.model_fields:
            known = {"preset", "file", *VehicleFile.model_fields}
            raise origin.error(f"vehicle.{name}", value, one_of(known, name))
    file, source = _find_in(origin, "vehicle", preset, path, folder)
    document = read_toml(file, source) | fields
    replaced = {
        name: (OVERRIDE if f"vehicle.{name}" in origin.replaced else origin.source, "vehicle.")
        for name in fields
    }
    car_origin = Origin(source, replaced)
    return validate(VehicleFile, document, car_origin), car_origin


def _profile(spec: TripFile, origin: Origin, folder: Path | None) -> Profile:
    """Profile of the trip's road, cut."""
    road = spec.route
    file, source = _find_in(origin, "route", road.preset, road.file, folder)
    stem = file.name.removesuffix(SUFFIX["routes"])
    profile = read_profile(file, source, stem)
    length = float(profile.node_km[-1])
    end = length if road.end_km is None else road.end_km
    if end > length:
        raise origin.error("route.end_km", end, f"at most the file's length, {length:g} km")
    if road.start_km >= end:
        raise origin.error("route.start_km", road.start_km, f"less than the end, {end:g} km")
    return profile.cut(road.start_km, end)
