"""Writes the generated trip: ``python -m benchmarks.data.trips [--check]``.

Owns the chargers of ``long-1000km-winter``, drawn with a fixed seed by class of site.
The other shipped trips are definitions, written by hand; this command leaves them alone.
Knows nothing of the route but its length.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

from benchmarks.data.emit import DATA, deliver
from benchmarks.data.long_route import LENGTH_KM, draw

__all__ = ["KINDS", "SITES", "Kind", "Site", "main", "sites", "texts"]

SEED = 20
SITES = 20
AMBIENT_C = -10.0
CELLS = 12
"""Enough for the smooth charge limit of ``paper-2022``. The steep drops of ``polestar-2-dual``
would need more: its stops charge across them."""


@dataclass(frozen=True)
class Kind:
    """A class of charging sites.

    Parameters
    ----------
    name : str
        Part of the chargers' names.
    count : int
        Sites of it.
    power_kw : tuple of float
        Ratings, dealt out in turn [kW].
    price_per_kwh : tuple of float
        Interval [SEK/kWh].
    detour_min : tuple of float
        Interval, both ways together [min].
    busy : int
        How many of them charge for occupation.
    """

    name: str
    count: int
    power_kw: tuple[float, ...]
    price_per_kwh: tuple[float, float]
    detour_min: tuple[float, float]
    busy: int


KINDS = (
    Kind("hub", 5, (300.0, 250.0), (6.6, 8.5), (3.0, 4.0), 4),
    Kind("rest area", 6, (150.0, 200.0), (5.4, 7.2), (3.0, 5.0), 1),
    Kind("town", 5, (100.0, 150.0), (4.4, 5.8), (5.0, 7.0), 1),
    Kind("shop", 4, (50.0, 75.0), (3.5, 4.6), (6.0, 8.0), 0),
)
"""Dear and fast beside the motorway, cheap and slow in town. Assumed."""

JITTER_KM = 14.0
"""A site lies at most this far from an even spacing: some are near neighbours."""
OCCUPANCY_FREE_MIN = 30.0
OCCUPANCY_PRICE_PER_MIN = 2.0

HEADER = f"""\
# A synthetic winter trip of {LENGTH_KM:.0f} km with {SITES} chargers, {2**SITES:,} subsets.
#
# Written by `python -m benchmarks.data.trips` (benchmarks/data/trips.py), seed {SEED}: for trying a
# search with many chargers. Facts: none; no road, site or price is real.
# Assumed: every figure. Hubs beside the motorway are fast and dear, town chargers cheap, slower and
# farther away; {sum(kind.busy for kind in KINDS)} sites, mostly hubs, ask a fee after \
{OCCUPANCY_FREE_MIN:.0f} min. About 0.12 kWh per minute of detour.
"""

HEAD = f"""
name = "long-1000km-winter"
description = "{LENGTH_KM:.0f} km at {AMBIENT_C:.0f} C, the paper's car, {SITES} synthetic sites"
currency = "SEK"
format = 1

[vehicle]
preset = "paper-2022"

[route]
preset = "long-1000km"
ambient_c = {AMBIENT_C}
"""

TAIL = f"""
[objective]
time_value_per_h = 150.0

[start]
soc = 0.9

[end]
soc_min = 0.1

[limits]
soc_min = 0.05

[grid]
step_km = 5.0
cells = {CELLS}
"""


@dataclass(frozen=True)
class Site:
    """A charging site of the trip, in the units of the trip file."""

    name: str
    position_km: float
    power_kw: float
    price_per_kwh: float
    detour_min: float
    detour_kwh: float
    occupied: bool

    def text(self) -> str:
        """Return its table of the trip file.

        Examples
        --------
        >>> print(Site("km 5 hub", 5.0, 300.0, 7.0, 3.0, 0.3, False).text(), end="")
        <BLANKLINE>
        [[charger]]
        name = "km 5 hub"
        position_km = 5.0
        power_kw = 300.0
        price_per_kwh = 7.0
        detour_min = 3.0
        detour_kwh = 0.3
        max_dwell_min = 120.0
        """
        fee = (
            f"occupancy_free_min = {OCCUPANCY_FREE_MIN}\n"
            f"occupancy_price_per_min = {OCCUPANCY_PRICE_PER_MIN}\n"
        )
        return (
            f'\n[[charger]]\nname = "{self.name}"\nposition_km = {self.position_km}\n'
            f"power_kw = {self.power_kw}\nprice_per_kwh = {self.price_per_kwh}\n"
            f"detour_min = {self.detour_min}\ndetour_kwh = {self.detour_kwh}\n"
            f"{fee if self.occupied else ''}max_dwell_min = 120.0\n"
        )


def sites() -> list[Site]:
    """Return the sites in the order of the road.

    Examples
    --------
    >>> made = sites()
    >>> len(made), made == sites(), made[0].position_km < made[-1].position_km
    (20, True, True)
    """
    random = Random(SEED)
    dealt = [(kind, j) for kind in KINDS for j in range(kind.count)]
    keys = [random.random() for _ in dealt]
    order = sorted(range(SITES), key=keys.__getitem__)
    made = []
    for slot, (kind, j) in enumerate(dealt[k] for k in order):
        even = LENGTH_KM * (slot + 1) / (SITES + 1)
        position = round(even + draw(random, (-JITTER_KM, JITTER_KM)))
        detour = round(2.0 * draw(random, kind.detour_min)) / 2.0
        made.append(
            Site(
                name=f"km {position} {kind.name}",
                position_km=float(position),
                power_kw=kind.power_kw[j % len(kind.power_kw)],
                price_per_kwh=round(draw(random, kind.price_per_kwh), 1),
                detour_min=detour,
                detour_kwh=round(0.12 * detour - 0.06, 2),
                occupied=j < kind.busy,
            )
        )
    return made


def texts() -> dict[str, str]:
    """Return the text of every generated trip by name.

    Examples
    --------
    >>> list(texts())
    ['long-1000km-winter']
    """
    body = "".join(site.text() for site in sites())
    return {"long-1000km-winter": HEADER + HEAD + body + TAIL}


def main(argv: Sequence[str] | None = None) -> int:
    """Write or compare the generated trip; return 1 when it differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.data.trips", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args(argv).check
    same = [deliver(DATA / "trips" / f"{n}.toml", t, check) for n, t in texts().items()]
    return 0 if all(same) else 1


if __name__ == "__main__":
    sys.exit(main())
