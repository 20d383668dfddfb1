"""Owns stages: the drive from one place to the next stop, and that stop, as an instance.

A plan is a chain of stages: from the start to its first stop, from stop to stop, and
from the last stop to the destination. Costs add up, and the only thing that passes
from stage to stage is the energy and temperature with which the car drives on. Knows
nothing of programs, bounds and solvers.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace

from relax.box import Box, Cell
from relax.instance import Drive, Instance, Stop
from relax.reach import make_box

__all__ = ["START", "make_stage", "stop_cells"]

START = -1
"""Number of the start, as if it were a stop; the destination is the number of all stops."""


def make_stage(instance: Instance, first: int, last: int) -> Instance:
    """Return the stage between two stops that follow each other in some plan.

    Parameters
    ----------
    instance : Instance
        The family of all subsets: every stop optional.
    first : int
        The stop that the car leaves, ``START`` for the start of the trip.
    last : int
        The next stop, with which the stage ends; the number of stops for the destination.

    Returns
    -------
    Instance
        One used stop, or none; it starts anywhere in its box's first interval. The limit
        of all stops' time together is left out.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> stage = make_stage(family, 0, 2)
    >>> float(stage.drive.node_km[0]), stage.subset, stage.stops[0].node == stage.drive.n_steps
    (100.0, (2,), True)
    """
    stops, drive = instance.stops, instance.drive
    a = 0 if first == START else stops[first].node
    b = drive.n_steps if last == len(stops) else stops[last].node
    nodes = ("node_km", "energy_min_kwh")
    steps = [f.name for f in fields(Drive) if f.name not in nodes]
    least = instance.energy_min_kwh[a : b + 1].copy()
    used: tuple[Stop, ...] = ()
    end = instance.end_energy_min_kwh
    if last < len(stops):
        stop = stops[last]
        used, end = (replace(stop, node=b - a, optional=False),), stop.leave_min_kwh
    if first != START:
        least[0] = stops[first].leave_min_kwh
    if last == len(stops):  # the family may arrive with less where it can charge
        least[-1] = max(float(least[-1]), end)
    return replace(
        instance,
        drive=replace(
            drive,
            node_km=drive.node_km[a : b + 1],
            energy_min_kwh=drive.energy_min_kwh[a : b + 1],
            **{name: getattr(drive, name)[a:b] for name in steps},
        ),
        stops=used,
        energy_min_kwh=least,
        end_energy_min_kwh=end,
        total_dwell_h=math.inf,
        free_start=True,
    )


def stop_cells(instance: Instance, box: Box | None = None) -> list[Cell | None]:
    """Return, for every stop, all states with which the car may drive on after using it.

    Parameters
    ----------
    instance : Instance
        The family of all subsets: every stop optional.
    box : Box, optional
        Its box; ``make_box`` by default.

    Returns
    -------
    list of Cell or None
        None for a stop that no feasible plan uses.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> len(stop_cells(family))
    3
    """
    box = make_box(instance) if box is None else box
    out: list[Cell | None] = []
    for i, never in enumerate(box.unusable):
        energy = float(box.leave.lo[i]), float(box.leave.hi[i])
        end = box.stop_temperature
        out.append(None if never else Cell(energy, (float(end.lo[i, -1]), float(end.hi[i, -1]))))
    return out
