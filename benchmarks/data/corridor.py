"""Owns the route ``goteborg-stockholm``: coarse real elevation, assumed speeds. Writes nothing.

The speed profile is an assumption by road class (speed limits a driver would
find on road 40 and the E4), not a measurement.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmarks.data.emit import SOURCES

__all__ = ["SPEED_SECTIONS", "corridor_text", "smooth"]

Array = npt.NDArray[np.float64]

SPEED_SECTIONS: tuple[tuple[float, float, str], ...] = (
    (0.0, 50.0, "Goteborg, streets"),
    (3.0, 70.0, "Goteborg, main roads"),
    (8.0, 100.0, "road 40 to Landvetter"),
    (24.0, 110.0, "road 40 to Boras"),
    (60.0, 80.0, "through Boras"),
    (67.0, 110.0, "road 40 to Jonkoping"),
    (142.0, 90.0, "Jonkoping, change to the E4"),
    (151.0, 110.0, "E4 along lake Vattern and across Ostergotland"),
    (307.0, 100.0, "past Norrkoping"),
    (319.0, 110.0, "E4 to Sodertalje"),
    (434.0, 90.0, "Sodertalje"),
    (443.0, 100.0, "E4 to the south of Stockholm"),
    (463.0, 70.0, "Stockholm, main roads"),
    (470.0, 50.0, "Stockholm, streets"),
)
"""From km, mean speed [km/h], where. Assumed."""

HEADER = """\
# Goteborg - Boras - Jonkoping - Linkoping - Stockholm, road 40 and E4, 473 km.
# Elevation: pvlib 0.16.1 (BSD-3-Clause; Mapzen terrain tiles), 5 arc-min cells along straight legs
# between towns, 7 km mean, here another 3 km mean: the plateau and lake Vattern are there, single
# hills are not, and single heights can be wrong by 100 m. Kilometres: great-circle legs scaled to
# the road length (+- 5 km). Speed: assumed by road class, constant per section; not a measurement.
"""


def smooth(values: Array, width: int = 3) -> Array:
    """Return the running mean over an odd number of points, ends kept.

    Examples
    --------
    >>> smooth(np.array([0.0, 3.0, 0.0, 3.0])).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    half = width // 2
    out = values.copy()
    out[half : values.size - half] = np.convolve(values, np.full(width, 1 / width), "valid")
    return out


def corridor_text() -> str:
    """Return the text of the route file.

    Examples
    --------
    >>> corridor_text().splitlines()[6]
    '0.0,50.0,39.3'
    """
    file = SOURCES / "goteborg_stockholm_elevation.csv"
    table = np.genfromtxt(file, delimiter=",", names=True, comments="#", skip_header=3)
    starts = [start for start, _, _ in SPEED_SECTIONS]
    border = np.arange(0.0, table["km"][-1] + 0.5, 1.0)
    height = np.interp(border, table["km"], smooth(table["elevation_m"]))
    section = np.searchsorted(starts, border[:-1], side="right") - 1
    speed = np.array([SPEED_SECTIONS[i][1] for i in section])
    rows = zip(border, np.append(speed, speed[-1]), height, strict=True)
    body = "".join(f"{s:.1f},{v:.1f},{z:.1f}\n" for s, v, z in rows)
    return HEADER + "distance_km,speed_kmh,elevation_m\n" + body
