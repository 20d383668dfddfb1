"""Owns the relaxation: the rows that every feasible trajectory of the transcription satisfies.

Chains the states and asks ``relaxation_drive`` and ``relaxation_stops`` for their
rows. Each nonconvex term is replaced by its envelopes on the box, on both sides
where a wrong value could pay off: a loss also heats, a heat pump also cools.
Equation labels (R1) .. (R10) are those of ``docs/relaxation.md``. Knows nothing of solvers.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.instance import Instance
from relax.intervals import Interval, pick
from relax.program import Assembly, ConeProgram
from relax.relaxation_drive import add_drive
from relax.relaxation_model import Index, Model, make_pumps, stack
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

    maybe = box.optional
    stop_temp = Interval(box.stop_temperature.lo[:, 1:], box.stop_temperature.hi[:, 1:])
    add("energy", every, 10.0, box.energy)
    add("temperature", every, 10.0, box.temperature)
    add("charge", each, 10.0, _or_zero(box.charge, maybe))
    add("leave", each, 10.0, box.after)
    add("stop_temperature", np.ones((S, K), dtype=bool), 10.0, _or_zero(stop_temp, maybe))
    used = v["used"] = rows.variable("used", maybe, scale=1.0, lo=0.0, hi=1.0)
    # what precedes a stop: its node, or the stop before it at the same node
    node = np.array([stop.node for stop in instance.stops], dtype=np.int64)
    into, out = stack(instance, "detour_in_kwh"), stack(instance, "detour_out_kwh")
    arrive = Interval(box.arrive.lo + into, box.arrive.hi + into)
    begin = Interval(box.stop_temperature.lo[:, 0], box.stop_temperature.hi[:, 0])
    add("share", maybe, 10.0, _or_zero(arrive, maybe))  # used * energy before the stop
    add("share_temperature", maybe, 10.0, _or_zero(begin, maybe))
    add("after_temperature", maybe, 10.0, box.after_temperature)
    before, t_before = v["energy"][node], v["temperature"][node]
    t_after = np.where(maybe, v["after_temperature"], v["stop_temperature"][:, -1])
    for i in range(1, S):
        if node[i] == node[i - 1]:
            before[i], t_before[i] = v["leave"][i - 1], t_after[i - 1]
    v["before"] = np.where(maybe, v["share"], before)
    t_begin = np.where(maybe, v["share_temperature"], t_before)
    v["border"] = np.concatenate([t_begin[:, None], v["stop_temperature"]], axis=1)
    rows.alias("border", v["border"])
    start, t_start = v["energy"][:-1].copy(), v["temperature"][:-1].copy()
    after = box.step_stop >= 0
    start[after] = v["leave"][box.step_stop[after]]
    t_start[after] = t_after[box.step_stop[after]]
    v["start"], v["start_temperature"] = start, t_start

    if instance.free_start:
        for name, x in (("energy", box.energy), ("temperature", box.temperature)):
            rows.less(f"start {name} at most", x.hi[:1], (v[name][:1], 1.0))
            rows.less(f"start {name} at least", -x.lo[:1], (v[name][:1], -1.0))
    else:
        rows.equal("start energy", [instance.start_energy_kwh], (v["energy"][0], 1.0))
        rows.equal("start temperature", [instance.start_temperature_c], (v["temperature"][0], 1.0))
    d, power, first = instance.drive.duration_h, box.power, box.start_energy
    # only where the neighbouring node's bound and the least power do not imply them
    upper = np.append(False, box.energy.hi[1:] < first.hi - d * power.lo - 1e-7)
    lower = np.append(box.energy.lo[:-1] > box.energy.lo[1:] + d * power.lo + 1e-7, True)
    lower[node[node < n]] = True
    rows.less("energy at most", box.energy.hi[upper], (v["energy"][upper], 1.0))
    rows.less("energy at least", -box.energy.lo[lower], (v["energy"][lower], -1.0))
    temperature = Interval(box.temperature.lo[1:], box.temperature.hi[1:])
    for name, column, x, unit in (
        ("temperature", v["temperature"][1:], temperature, None),
        ("charge", v["charge"], box.charge, used),
        ("after", v["leave"], box.after, None),
        ("stop temperature", v["stop_temperature"], stop_temp, used[:, None]),
        ("arrive", v["before"], arrive, used),
    ):
        rows.less(f"{name} at most", x.hi, (column, 1.0), unit=unit)
        rows.less(f"{name} at least", -x.lo, (column, -1.0), unit=unit)
    rows.less(
        "charged at most", instance.energy_max_kwh + into,
        (v["before"], 1.0), (v["charge"], 1.0), unit=used,
    )  # fmt: skip
    rows.equal(
        "leave", -into - out, (v["leave"], 1.0), (before, -1.0), (v["charge"], -1.0), unit=used
    )  # (R1)
    if maybe.any():
        _add_passing(model, before, t_before, begin)
    model.cost["used"] = stack(instance, "fixed_cost")


def _or_zero(x: Interval, maybe: npt.NDArray[np.bool_]) -> Interval:
    """Return the interval of x * used: with 0 where ``used`` may be 0."""
    on = maybe.reshape(maybe.shape + (1,) * (x.lo.ndim - 1))
    return Interval(np.where(on, np.minimum(x.lo, 0.0), x.lo),
                    np.where(on, np.maximum(x.hi, 0.0), x.hi))  # fmt: skip


def _add_passing(model: Model, before: Index, t_before: Index, begin: Interval) -> None:
    """Let what an optional stop does not use pass by with its energy and temperature (R10).

    The perspective of the stop's rows, with ``used`` in place of 1, on one side; the point
    of driving past, with 1 - ``used`` in place of 1, on the other.
    """
    rows, box, v = model.rows, model.box, model.v
    on = box.optional
    used, W = v["used"][on], v["charge"][on]
    out = stack(model.instance, "detour_out_kwh")[on]
    into = stack(model.instance, "detour_in_kwh")[on]
    share, before, t_before = v["share"][on], before[on], t_before[on]
    t_share, t_after, t_end = (
        v["share_temperature"][on], v["after_temperature"][on], v["stop_temperature"][on, -1],
    )  # fmt: skip
    lo, hi = box.leave.lo[on] + into + out, box.leave.hi[on] + into + out
    rows.less("leave at most", np.zeros(lo.shape), (share, 1.0), (W, 1.0), (used, -hi))
    rows.less("leave at least", np.zeros(lo.shape), (share, -1.0), (W, -1.0), (used, lo))
    after = pick(box.after, on)
    rows.less("pass at most", after.hi, (before, 1.0), (share, -1.0), (used, after.hi))
    rows.less("pass at least", -after.lo, (before, -1.0), (share, 1.0), (used, -after.lo))
    first, after = pick(begin, on), pick(box.after_temperature, on)
    zero = np.zeros(used.shape)
    rows.less("begin temperature at most", zero, (t_share, 1.0), (used, -first.hi))
    rows.less("begin temperature at least", zero, (t_share, -1.0), (used, first.lo))
    rows.less("pass temperature at most", after.hi, (t_before, 1.0), (t_share, -1.0),
              (used, after.hi))  # fmt: skip
    rows.less("pass temperature at least", -after.lo, (t_before, -1.0), (t_share, 1.0),
              (used, -after.lo))  # fmt: skip
    rows.equal("pass temperature", zero, (t_after, 1.0), (t_end, -1.0), (t_before, -1.0),
               (t_share, 1.0))  # fmt: skip
    rows.less("used at most", np.ones(used.shape), (used, 1.0))
    least, most = np.array(box.count) - np.count_nonzero(~on)
    every = [(column[None], 1.0) for column in used]
    if least > 0:
        rows.less("stops at least", [-float(least)], *((i, -a) for i, a in every))
    if most < used.size:
        rows.less("stops at most", [float(most)], *every)


def build_relaxation(instance: Instance, box: Box, *, lean: bool = False) -> ConeProgram:
    """Return the cone relaxation of a subset or family on a box.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box
        Not empty, from ``make_box`` or tightened.
    lean : bool
        Without the cones of driving losses where planes miss at most ``NEAR_KW``, as proofs
        want it: as good a bound in less time.

    Returns
    -------
    ConeProgram
        Outer approximation: every feasible trajectory in the box satisfies its rows
        (``lift`` gives its point) at the trajectory's own cost.

    Raises
    ------
    ValueError
        The box is empty.

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
    with np.errstate(divide="raise", invalid="raise"):
        model = Model(Assembly(), instance, box, {}, {}, make_pumps(instance, box), lean)
        _add_states(model)
        add_drive(model)
        if instance.stops:
            add_stops(model)
    return model.rows.build(model.cost, instance.fixed_cost)
