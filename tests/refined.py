"""Owns the nine cases on which refinement is tested, each refined once, when it is asked for.

``paper`` builds instances of the paper's trip, in other weather and with another car;
``refined`` refines a case from its even start.
"""

from __future__ import annotations

from functools import cache

from trips import small_trip

from relax import Instance, load_trip, make_instance, refine
from relax.refinement import Refined
from relax.starts import even_start

__all__ = ["CASES", "paper", "refined"]


def paper(subset: tuple[int, ...], **overrides: float) -> Instance:
    """Return a subset of the paper's trip; overrides: ``ambient``, ``pump`` and ``time``."""
    names = {"ambient": "route.ambient_c", "pump": "vehicle.heat_pump_kw"}
    names["time"] = "objective.time_value_per_h"
    trip = load_trip("paper-400km", {names[k]: v for k, v in overrides.items()})
    return make_instance(trip, subset)


def cases() -> dict[str, Instance]:
    """Return the nine cases: subsets of long and of short trips, in all weathers."""
    return {
        "one stop": paper((1,)),
        "two stops": paper((0, 2)),
        "three stops, fast": paper((0, 1, 2), time=400.0, pump=3.0),
        "mild, no pump": paper((1, 2), ambient=10.0, pump=0.0, time=0.0),
        "summer": make_instance(load_trip("goteborg-stockholm-summer"), (3, 6)),
        "winter": make_instance(load_trip("goteborg-stockholm-winter"), (1, 4)),
        "small": make_instance(small_trip(), (0,)),
        "hot": make_instance(small_trip(ambient_c=35.0), (0,)),
        "small, cold": make_instance(small_trip(ambient_c=-20.0), (0, 1)),
    }


CASES = cases()


@cache
def refined(name: str) -> Refined:
    """Return the case's plan, refined from its even start."""
    return refine(CASES[name], even_start(CASES[name]))
