"""Owns where a box is cut that shrinks no further. Chooses, never proves.

A fixed subset is cut at the widest of charge, stay and temperature at its stops, in units that
count alike; but first at a temperature on the way or amid a stop where the relaxed optimum breaks
a charge limit by much, which no other cut would end.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.branch import Branch, Target
from relax.instance import Instance
from relax.intervals import Interval, range2
from relax.program import ConeProgram

__all__ = ["at_stops", "charges", "next_cut", "stays", "undecided", "wide_charge", "widest"]

Array = npt.NDArray[np.float64]

WIDE_CHARGE_KWH = 9.0
"""Stops whose charge is less certain than this are cut before temperatures are bounded: until
then temperature bounds are loose. Widths of 6, 9, 13 and 18 kWh differ by 5 % in time."""
LEAST_SPLIT = {"charge": 0.5, "stay": 0.02, "temperature": 1.0, "stop_temperature": 1.0}
"""Intervals narrower than this are not cut [kWh, h, K]."""
SPLIT_UNIT = {"charge": 3.0, "stay": 0.15, "temperature": 8.0, "stop_temperature": 8.0}
"""Widths that count alike when the quantity to cut is chosen [kWh, h, K]."""
DECIDED = 0.02
"""An optional stop used by less than this, or by all but this, counts as decided."""
REFUSED_KWH = 0.2
"""Recuperation beyond what the battery takes, in one step of the relaxed optimum, from which the
temperature there is cut first [kWh]."""
TOO_FAST_KWH = 0.1
"""The same for what a cell charges beyond the limit [kWh] ..."""
AMID = 1.5
"""... if the temperature there is wider than this many times that on arrival and at the end."""


def charges(box: Box) -> list[Target]:
    """Return the charges of all stops."""
    return [Target("charge", i, "charge") for i in range(box.charge.lo.size)]


def stays(box: Box) -> list[Target]:
    """Return the stays at all stops."""
    return [Target("stay", i, "dwell") for i in range(box.stay.lo.size)]


def at_stops(instance: Instance) -> list[Target]:
    """Return the temperatures on arrival at every used stop and at its end."""
    out = []
    for i, stop in enumerate(instance.stops):
        if not stop.optional:
            out.append(Target("temperature", stop.node, "temperature"))
            out.append(Target("stop_temperature", (i, instance.cells), "border"))
    return out


def undecided(box: Box, used: Array) -> Branch:
    """Where to cut a box with optional stops: by their number first, then by the least certain."""
    least, most = box.count
    if least < most:
        at = int(np.clip(np.floor(used.sum() + DECIDED), least, most - 1))
        return Branch("count", at=at)
    doubt = np.where(box.optional, np.minimum(used, 1.0 - used), -1.0)
    if doubt.max() < DECIDED:
        doubt = np.where(box.optional, used, -1.0)
    return Branch("use", stop=int(doubt.argmax()))


def wide_charge(box: Box) -> Branch | None:
    """Where to cut if the charge of a stop is too uncertain to bound anything else."""
    if box.charge.width.max(initial=0.0) <= WIDE_CHARGE_KWH:
        return None
    return _halve(box, Target("charge", int(box.charge.width.argmax()), "charge"))


def next_cut(instance: Instance, box: Box, program: ConeProgram, x: Array) -> Branch | None:
    """Where to cut a box of used stops; None if it is too small.

    Parameters
    ----------
    instance : Instance
        Fixed subset.
    box : Box
        What is left.
    program : ConeProgram
        The last relaxation.
    x : ndarray
        Its optimum; not finite if it was not solved.
    """
    broken = None
    if np.isfinite(x).all():
        broken = _refused(instance, box, program, x) or _too_fast(instance, box, program, x)
    return broken or widest(instance, box) or _widest_within(box)


def widest(instance: Instance, box: Box) -> Branch | None:
    """Where to cut a box of used stops: the quantity at them that is widest for its kind."""
    best, choice = 0.0, None
    for target in (*charges(box), *stays(box), *at_stops(instance)):
        interval: Interval = getattr(box, target.name)
        lo, hi = float(interval.lo[target.index]), float(interval.hi[target.index])
        share = (hi - lo) / SPLIT_UNIT[target.name]
        if hi - lo > LEAST_SPLIT[target.name] and share > best:
            best, choice = share, Branch("halve", target, 0.5 * (lo + hi))
    return choice


def _widest_within(box: Box) -> Branch | None:
    """Where to cut when arrivals, stays and charges are known: the widest temperature between."""
    best, choice = LEAST_SPLIT["temperature"], None
    for name, variable in (("temperature", "temperature"), ("stop_temperature", "border")):
        interval: Interval = getattr(box, name)
        if interval.width.max(initial=0.0) > best:
            at = np.unravel_index(int(interval.width.argmax()), interval.width.shape)
            index = (int(at[0]), int(at[1])) if len(at) == 2 else int(at[0])
            best, choice = float(interval.width[at]), _halve(box, Target(name, index, variable))
    return choice


def _refused(instance: Instance, box: Box, program: ConeProgram, x: Array) -> Branch | None:
    """Where to cut if the relaxed optimum recuperates what its battery is too cold to take."""
    if not np.any(box.power.lo < 0.0):
        return None
    temp = program.value("temperature", x)
    limit = _limit(instance, box.middle_energy.mid, 0.5 * (temp[1:] + temp[:-1]))
    excess = (-program.value("power", x) - limit) * instance.drive.duration_h
    k = int(excess.argmax())
    width = box.temperature.width
    at = k + int(width[k + 1] > width[k])
    if excess[k] < REFUSED_KWH or width[at] <= LEAST_SPLIT["temperature"]:
        return None
    return _halve(box, Target("temperature", at, "temperature"))


def _too_fast(instance: Instance, box: Box, program: ConeProgram, x: Array) -> Branch | None:
    """Where to cut if the relaxed optimum charges too fast amid a stop, where least is known."""
    if not instance.stops:
        return None
    charge, dwell, border = (program.value(n, x) for n in ("charge", "dwell", "border"))
    energy = box.cell_energy(np.array([s.detour_out_kwh for s in instance.stops])).mid
    limit = _limit(instance, energy.ravel(), (0.5 * (border[:, 1:] + border[:, :-1])).ravel())
    excess = charge[:, None] / instance.cells - limit.reshape(dwell.shape) * dwell
    i, j = (int(n) for n in np.unravel_index(int(excess.argmax()), excess.shape))
    width = box.stop_temperature.width[i]
    at = j + int(width[j + 1] > width[j])
    if excess[i, j] < TOO_FAST_KWH or width[at] <= AMID * max(width[0], width[-1]):
        return None
    if width[at] <= LEAST_SPLIT["stop_temperature"]:
        return None
    return _halve(box, Target("stop_temperature", (i, at), "border"))


def _limit(instance: Instance, energy: Array, temp: Array) -> Array:
    """Return the charge limit at points, at the table's edge beyond it [kW]."""
    table = instance.vehicle.pack.charge_limit_kw
    return range2(table, Interval(energy, energy), Interval(temp, temp)).hi


def _halve(box: Box, target: Target) -> Branch:
    """Cut an interval in its middle."""
    interval: Interval = getattr(box, target.name)
    return Branch("halve", target, float(interval.mid[target.index]))
