"""Owns the route CSV: columns, rows, units. Knows nothing of vehicles or chargers.

Columns: ``distance_km``, ``speed_kmh``, then ``elevation_m`` or ``grade`` (dz/ds),
``propulsion_kw``, ``drivetrain_heat_kw``, ``ambient_c`` as wanted. Row k holds from its
distance to the next row's; the last row only marks the end (and its elevation).
Lines that begin with ``#`` are comments.
"""

from __future__ import annotations

import csv
import math
from importlib.resources.abc import Traversable

import numpy as np
import numpy.typing as npt

from relax.document import one_of, read_text
from relax.errors import InputError
from relax.propulsion import Profile

__all__ = ["read_profile"]

Array = npt.NDArray[np.float64]

LEAST_STEP_KM = 1e-6
"""Shortest row [km]."""

RANGES = {
    "distance_km": (0.0, 20000.0),
    "speed_kmh": (0.0, 300.0),
    "elevation_m": (-500.0, 9000.0),
    "grade": (-0.4, 0.4),
    "propulsion_kw": (-1000.0, 1000.0),
    "drivetrain_heat_kw": (0.0, 1000.0),
    "ambient_c": (-60.0, 100.0),
}
"""Known columns and their ranges: wide, to catch wrong units (percent for grade, m for km)."""


def read_profile(file: Traversable, source: str, name: str) -> Profile:
    r"""Return the profile in a CSV file.

    Parameters
    ----------
    file : Traversable
        The file.
    source, name : str
        Shown in errors; name of the profile.

    Returns
    -------
    Profile

    Raises
    ------
    InputError
        Names file, line, column, value and what is allowed.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = tempfile.TemporaryDirectory()
    >>> file = pathlib.Path(folder.name, "road.csv")
    >>> _ = file.write_text("distance_km,speed_kmh\n0,50\n2,100\n5,\n")
    >>> read_profile(file, "road.csv", "road").speed_kmh
    array([ 50., 100.])
    >>> folder.cleanup()
    """
    lines = list(enumerate(read_text(file, source).splitlines(), start=1))
    kept = [(k, line) for k, line in lines if line.strip() and not line.lstrip().startswith("#")]
    numbers = [k for k, _ in kept]
    try:
        cells = [[cell.strip() for cell in row] for row in csv.reader(line for _, line in kept)]
    except csv.Error as error:
        raise InputError(source, "rows", str(error), "rows of a CSV file") from error
    if not cells:
        raise InputError(source, "header", None, "columns distance_km, speed_kmh, ...")
    header = cells[0]
    _check_header(header, source)
    if len(cells) < 3:
        raise InputError(source, "rows", len(cells) - 1, "at least 2 rows below the header")
    columns = {}
    for c, column in enumerate(header):
        columns[column] = np.array(
            [
                _number(row, c, header, f"{source}", numbers[k], k == len(cells) - 1)
                for k, row in enumerate(cells[1:], start=1)
            ]
        )
    distance = columns["distance_km"]
    if distance[0] != 0.0:
        raise InputError(source, f"line {numbers[1]} distance_km", float(distance[0]), "0 at first")
    for k in np.flatnonzero(np.diff(distance) <= LEAST_STEP_KM)[:1]:
        raise InputError(
            source,
            f"line {numbers[k + 2]} distance_km",
            float(distance[k + 1]),
            f"more than the row before, {distance[k]:g}",
        )
    return Profile(
        name,
        distance,
        columns["speed_kmh"][:-1],
        _grade(columns, source, numbers),
        *(
            columns[column][:-1] if column in columns else None
            for column in ("propulsion_kw", "drivetrain_heat_kw", "ambient_c")
        ),
    )


def _check_header(header: list[str], source: str) -> None:
    for name in header:
        if name not in RANGES:
            raise InputError(source, "header", name, one_of(RANGES, name))
        if header.count(name) > 1:
            raise InputError(source, "header", name, "each column once")
    for name in ("distance_km", "speed_kmh"):
        if name not in header:
            raise InputError(source, f"header {name}", None, "columns distance_km and speed_kmh")
    if "grade" in header and "elevation_m" in header:
        raise InputError(source, "header", "grade", "either elevation_m or grade, not both")


def _number(row: list[str], c: int, header: list[str], source: str, line: int, last: bool) -> float:
    """Cell as a number within its range; the last row needs distance and elevation only."""
    column = header[c]
    field = f"line {line} {column}"
    if len(row) > len(header) or (len(row) < len(header) and not last):
        raise InputError(source, f"line {line}", ",".join(row), f"{len(header)} cells")
    text = row[c] if c < len(row) else ""
    if last and column not in ("distance_km", "elevation_m"):
        return 0.0
    lo, hi = RANGES[column]
    try:
        value = float(text)
    except ValueError:
        raise InputError(source, field, text or None, f"a number, {lo:g} to {hi:g}") from None
    if not (math.isfinite(value) and lo <= value <= hi):
        raise InputError(source, field, value, f"a number, {lo:g} to {hi:g}")
    if column == "speed_kmh" and value == 0.0:
        raise InputError(source, field, value, "more than 0: leave standstill out of the route")
    return value


def _grade(columns: dict[str, Array], source: str, numbers: list[int]) -> Array:
    if "grade" in columns:
        return columns["grade"][:-1]
    if "elevation_m" not in columns:
        return np.zeros(columns["speed_kmh"].size - 1)
    grade: Array = np.diff(columns["elevation_m"]) / (1000.0 * np.diff(columns["distance_km"]))
    lo, hi = RANGES["grade"]
    for k in np.flatnonzero((grade < lo) | (grade > hi))[:1]:
        raise InputError(
            source,
            f"line {numbers[k + 1]} elevation_m",
            float(columns["elevation_m"][k]),
            f"a grade from {lo:g} to {hi:g} to the next row, not {grade[k]:.3g}",
        )
    return grade
