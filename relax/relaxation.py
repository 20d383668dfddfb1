"""Owns the relaxation: the rows that every feasible trajectory of the transcription satisfies.

Chains the states and asks ``relaxation_drive`` and ``relaxation_stops`` for their
rows. Each nonconvex term is replaced by its envelopes on the box, on both sides
where a wrong value could pay off: a loss also heats, a heat pump also cools.
Equation labels (R1) .. (R9) are those of ``docs/relaxation.md``. Knows nothing of solvers.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.instance import Instance
from relax.intervals import Interval
from relax.program import Assembly, ConeProgram
from relax.relaxation_drive import add_drive
from relax.relaxation_model import Model, stack
from relax.relaxation_stops import add_stops

__all__ = ["build_relaxation"]

Array = npt.NDArray[np.float64]


def _add_states(model: Model) -> None:
    """Add variables of the chain of energies and temperatures, their bounds, and its start."""
    rows, box, instance, v = model.rows, model.box, model.instance, model.v
    n, S, K = instance.drive.n_steps, len(instance.stops), instance.cells
    every, each = np.ones(n + 1, dtype=bool), np.ones(S, dtype=bool)

    def add(name: str, exists: Array | npt.NDArray[np.bool_], scale: float, x: Interval) -> None:
        v[name] = rows.variable(name, exists, scale=scale, lo=x.lo, hi=x.hi)

    stop_temp = Interval(box.stop_temperature.lo[:, 1:], box.stop_temperature.hi[:, 1:])
    add("energy", every, 10.0, box.energy)
    add("temperature", every, 10.0, box.temperature)
    add("charge", each, 10.0, box.charge)
    add("leave", each, 10.0, box.leave)
    add("stop_temperature", np.ones((S, K), dtype=bool), 10.0, stop_temp)
    # what precedes a stop: its node, or the stop before it at the same node
    node = np.array([stop.node for stop in instance.stops], dtype=np.int64)
    before, t_before = v["energy"][node], v["temperature"][node]
    for i in range(1, S):
        if node[i] == node[i - 1]:
            before[i], t_before[i] = v["leave"][i - 1], v["stop_temperature"][i - 1, -1]
    v["before"] = before
    v["border"] = np.concatenate([t_before[:, None], v["stop_temperature"]], axis=1)
    rows.alias("border", v["border"])
    start, t_start = v["energy"][:-1].copy(), v["temperature"][:-1].copy()
    after = box.step_stop >= 0
    start[after] = v["leave"][box.step_stop[after]]
    t_start[after] = v["stop_temperature"][box.step_stop[after], -1]
    v["start"], v["start_temperature"] = start, t_start

    rows.equal("start energy", [instance.start_energy_kwh], (v["energy"][0], 1.0))
    rows.equal("start temperature", [instance.start_temperature_c], (v["temperature"][0], 1.0))
    d, power, first = instance.drive.duration_h, box.power, box.start_energy
    # only where the neighbouring node's bound and the least power do not imply them
    upper = np.append(False, box.energy.hi[1:] < first.hi - d * power.lo - 1e-7)
    lower = np.append(box.energy.lo[:-1] > box.energy.lo[1:] + d * power.lo + 1e-7, True)
    lower[node[node < n]] = True
    rows.less("energy at most", box.energy.hi[upper], (v["energy"][upper], 1.0))
    rows.less("energy at least", -box.energy.lo[lower], (v["energy"][lower], -1.0))
    for name, column, x in (
        ("temperature", v["temperature"][1:],
         Interval(box.temperature.lo[1:], box.temperature.hi[1:])),
        ("charge", v["charge"], box.charge),
        ("leave", v["leave"], box.leave),
        ("stop temperature", v["stop_temperature"], stop_temp),
    ):  # fmt: skip
        rows.less(f"{name} at most", x.hi, (column, 1.0))
        rows.less(f"{name} at least", -x.lo, (column, -1.0))
    into, out = stack(instance, "detour_in_kwh"), stack(instance, "detour_out_kwh")
    rows.less("arrive at most", box.arrive.hi + into, (before, 1.0))
    rows.less("arrive at least", -box.arrive.lo - into, (before, -1.0))
    rows.less("charged at most", instance.energy_max_kwh + into, (before, 1.0), (v["charge"], 1.0))
    rows.equal("leave", -into - out, (v["leave"], 1.0), (before, -1.0), (v["charge"], -1.0))  # (R1)


def build_relaxation(instance: Instance, box: Box) -> ConeProgram:
    """Return the cone relaxation of a fixed subset on a box.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box
        Not empty, from ``make_box`` or tightened.

    Returns
    -------
    ConeProgram
        Outer approximation: every feasible trajectory in the box satisfies its rows
        (``lift`` gives its point) at the trajectory's own cost.

    Raises
    ------
    ValueError
        The box is empty, or the heat pump's heat falls with its power.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> program = build_relaxation(instance, make_box(instance))
    >>> program.variables["dwell"].shape
    (1, 12)
    """
    if box.empty:
        raise ValueError(f"the box is empty: {box.empty}")
    if instance.vehicle.heat_pump_droop_per_kw * instance.vehicle.heat_pump_kw >= 1.0:
        raise ValueError("heat_pump_droop_per_kw * heat_pump_kw must stay below 1")
    model = Model(Assembly(), instance, box, {}, {})
    with np.errstate(divide="raise", invalid="raise"):
        _add_states(model)
        add_drive(model)
        if instance.stops:
            add_stops(model)
    return model.rows.build(model.cost, instance.fixed_cost)
