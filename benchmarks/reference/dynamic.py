"""Owns the dynamic programme as a peer: a global value with a stated grid error, and its plan.

The value is that of the problem on a mesh: no relaxation, no gradient, no start, and all 2^N
choices of stops at once. It is an estimate and proves nothing, but its error shrinks as the
mesh is refined, and its errors are of another kind than ours. Charging cells are small and
of fixed energy instead of W / K, so it is nearer to continuous charging than the
transcription. The plan is simulated and replayed as those of the other peers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, log2, nan
from time import perf_counter

from benchmarks.reference.dynamic_forward import Forward, follow
from benchmarks.reference.dynamic_tables import BIG, Resolution, ValueTables
from benchmarks.reference.dynamic_value import compute_tables
from relax.completion import complete
from relax.execute import execute
from relax.instance import make_instance
from relax.plan import Controls, Trajectory
from relax.refinement import Refined
from relax.simulate import Simulation, is_feasible
from relax.trip import Trip

__all__ = ["COARSE", "FINE", "MEDIUM", "Dynamic", "Resolution", "dynamic_best", "grid_error"]

COARSE = Resolution(temperature_k=4.0, cell_kwh=2.0, surplus=20)
"""About 3 to 6 times as fast as ``MEDIUM``."""
MEDIUM = Resolution(temperature_k=2.0, cell_kwh=1.0, surplus=40)
"""Half the spacings of ``COARSE``."""
FINE = Resolution(temperature_k=1.0, cell_kwh=0.5, surplus=80)
"""Half the spacings of ``MEDIUM``."""
COLD_END_K = 1.0
"""A plan that comes nearer to the cold end of the mesh is sought again on a wider one [K]."""
ORDERS = (1.0, 2.0)
"""Orders of convergence that are believed: decisions have kinks, interpolation is smooth."""


@dataclass(frozen=True)
class Dynamic:
    """What dynamic programming gives.

    Parameters
    ----------
    value : float
        Least cost on the finest mesh [currency]; ``inf`` if no plan exists there.
    extrapolated : float
        Value for a vanishing mesh, by Richardson; the value itself where the refinement is
        not regular. This is the claim.
    error : float
        Estimate of the error of the claim; ``inf`` from one mesh [currency].
    order : float
        Observed order of convergence; NaN where it is not regular.
    values, seconds, states : tuple
        Value, time of the recursion [s] and states per node, mesh by mesh.
    subset : tuple of int
        Stops of the plan.
    controls, trajectory : Controls, Trajectory or None
        The plan, and what it causes on the transcription.
    cost : float
        Its cost there; ``inf`` if it breaks a limit [currency].
    replayed_cost : float
        Its cost on the continuous model; NaN if it does not hold there [currency].
    feasible : bool
        Whether it keeps every limit of the transcription.
    judge_s : float
        Time of forward pass, simulation and replay [s].
    cold_end_k : float
        Distance of the plan from the cold end of the mesh: large enough not to matter [K].
    cooling_kw : float
        Largest battery cooling power of the plan; 0: cooling is idle.
    """

    value: float
    extrapolated: float
    error: float
    order: float
    values: tuple[float, ...]
    seconds: tuple[float, ...]
    states: tuple[int, ...]
    subset: tuple[int, ...] = ()
    controls: Controls | None = None
    trajectory: Trajectory | None = None
    cost: float = inf
    replayed_cost: float = nan
    feasible: bool = False
    judge_s: float = 0.0
    cold_end_k: float = nan
    cooling_kw: float = nan


def grid_error(values: tuple[float, ...]) -> tuple[float, float, float]:
    """Return extrapolated value, its error and the observed order, from halved meshes.

    With three meshes whose differences shrink and keep their sign the observed order,
    kept within 1 and 2, extrapolates; otherwise the claim is the last value. The error is
    the larger of the last difference and half of the one before it: what order 1 leaves.

    Parameters
    ----------
    values : tuple of float
        Values of meshes, each of half the spacing of the one before.

    Examples
    --------
    >>> grid_error((104.0, 101.0, 100.25))
    (100.0, 1.5, 2.0)
    >>> grid_error((101.0, 100.0, 100.5))
    (100.5, 0.5, nan)
    """
    if len(values) < 2 or not values[-1] < inf:
        return values[-1], inf, nan
    last = values[-1] - values[-2]
    if len(values) < 3:
        return values[-1], abs(last), nan
    before = values[-2] - values[-3]
    error = max(abs(last), 0.5 * abs(before))
    if last == 0.0 or before / last <= 1.0:
        return values[-1], error, nan
    order = min(max(log2(before / last), ORDERS[0]), ORDERS[1])
    return values[-1] + last / (2.0**order - 1.0), error, order


def dynamic_best(
    trip: Trip,
    subset: tuple[int, ...] | None = None,
    resolutions: tuple[Resolution, ...] = (COARSE, MEDIUM, FINE),
    judge: bool = True,
) -> Dynamic:
    """Return value, error and plan by dynamic programming.

    Parameters
    ----------
    trip : Trip
        The trip.
    subset : tuple of int, optional
        Exactly these chargers; the best of all subsets by default.
    resolutions : tuple of Resolution
        Meshes from coarse to fine, each half the one before.
    judge : bool
        Whether to follow the finest tables to a plan and judge it.

    Raises
    ------
    ValueError
        No resolution, or the trip limits the time of all stops together.

    Notes
    -----
    Not in the recursion: the longest dwell (the judge checks it), and the least charge of
    0.1 kWh. An occupancy fee enters with fixed shares of its price, the largest value
    counts: a lower estimate, exact unless the best dwell is the free time itself. Power and
    temperature limits are penalised, steeply but finitely; energy limits are exact.

    Examples
    --------
    >>> from relax import load_trip
    >>> meshes = (Resolution(8.0, 4.0, 10, heater=2, pump=2), Resolution(4.0, 2.0, 20))
    >>> found = dynamic_best(load_trip("paper-400km"), resolutions=meshes)
    >>> found.subset, found.feasible, abs(found.cost / found.value - 1.0) < 0.01
    ((1,), True, True)
    """
    values: list[float] = []
    seconds: list[float] = []
    states: list[int] = []
    tables: ValueTables | None = None
    for resolution in resolutions:
        begin = perf_counter()
        tables = compute_tables(trip, resolution, subset)
        value = tables.value_at_start
        values.append(value if value < 0.5 * BIG else inf)
        seconds.append(perf_counter() - begin)
        states.append(tables.temperature_c.size * tables.surplus_kwh.size)
    if tables is None:
        raise ValueError("dynamic programming needs at least one resolution")
    extrapolated, error, order = grid_error(tuple(values))
    claim = Dynamic(
        values[-1], extrapolated, error, order, tuple(values), tuple(seconds), tuple(states)
    )
    if not judge or values[-1] == inf:
        return claim
    begin = perf_counter()
    plan = follow(tables)
    if plan is None:
        return claim
    least_c = trip.vehicle.pack.temperature_min_c
    if plan.cold_end_k < COLD_END_K and float(tables.temperature_c[0]) > least_c:
        wider = tuple(replace(r, below_ambient_k=2.0 * r.below_ambient_k) for r in resolutions)
        return dynamic_best(trip, subset, wider, judge)
    return _judged(trip, claim, plan, begin)


def _judged(trip: Trip, claim: Dynamic, plan: Forward, begin: float) -> Dynamic:
    """Return the claim with its plan, simulated and replayed; nothing is optimised here."""
    instance = make_instance(trip, plan.subset)
    controls, trajectory = complete(Simulation(instance), plan.controls, plan.tight)
    feasible = is_feasible(trajectory)
    replayed_cost = nan
    if feasible:
        done = execute(trip, instance, Refined(controls, trajectory, feasible, 0))
        # a repaired plan is no longer the one that was found here
        own = done.trajectory is trajectory
        if own and not done.reason and done.replay is not None:
            replayed_cost = done.replay.cost
    return replace(
        claim,
        subset=plan.subset,
        controls=controls,
        trajectory=trajectory,
        cost=trajectory.cost if feasible else inf,
        replayed_cost=replayed_cost,
        feasible=feasible,
        judge_s=perf_counter() - begin,
        cold_end_k=plan.cold_end_k,
        cooling_kw=plan.cooling_kw,
    )
