"""Owns the rivals of a proof: drives and plans at random, and spoilt dual vectors.

Whatever is claimed of a subset must hold for every trajectory that anybody finds here, and
for every vector that is given to the certifier. Knows nothing of the claims.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
import numpy.typing as npt

from benchmarks.contradiction import Effort
from relax.bound import relax_subset
from relax.completion import complete, merit
from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, StopControls, Trajectory
from relax.refinement import RefineSettings, refine
from relax.simulate import Simulation, simulate
from relax.starts import best_start, even_start, warm_start

__all__ = [
    "Known", "attacked", "drive_at_random", "random_controls", "refine_at_random",
    "strictly_feasible",
]  # fmt: skip

Array = npt.NDArray[np.float64]
Random = np.random.Generator

STRICT = 1e-9
"""Largest violation of a trajectory that must lie in every box [kWh, K, kW, h]."""
INSIDE_KWH = 4e-5
"""How far inside its energy limits a plan is moved to be strictly feasible [kWh]."""


def random_controls(instance: Instance, rng: Random) -> Controls:
    """Return controls of any kind: idle, full, in bursts; the energy split at random."""
    car, n, cells = instance.vehicle, instance.drive.n_steps, instance.cells

    def powers(most: float, size: int, chance: float) -> Array:
        if rng.random() > chance:
            return np.zeros(size)
        level = most * (rng.uniform(0.0, 1.3, size) if rng.random() < 0.5 else rng.random())
        return np.where(rng.random(size) < rng.choice([0.2, 0.6, 1.0]), level, 0.0)

    need = float(instance.drive.base_kw @ instance.drive.duration_h) * rng.uniform(1.0, 1.5)
    need += instance.end_energy_min_kwh - instance.start_energy_kwh
    share = rng.dirichlet(np.full(max(len(instance.stops), 1), 0.7))
    stops = tuple(
        StopControls(
            max(float(w) * max(need, 1.0), MIN_CHARGE_KWH),
            np.where(rng.random(cells) < 0.7, np.inf, rng.uniform(3.0, 90.0, cells)),
            powers(car.heater_kw, cells, 0.5),
            powers(car.cooling_kw, cells, 0.3),
            powers(car.heat_pump_kw, cells, 0.7),
        )
        for w in share[: len(instance.stops)]
    )
    return Controls(
        powers(car.heater_kw, n, 0.5),
        powers(car.cooling_kw, n, 0.3),
        powers(car.heat_pump_kw, n, 0.7),
        stops,
    )


def strictly_feasible(instance: Instance, controls: Controls) -> Trajectory | None:
    """Return a trajectory near the controls' that keeps every limit exactly, if there is one."""
    trajectory = simulate(instance, controls)
    if float(trajectory.violation.max()) <= STRICT:
        return trajectory
    least = instance.energy_min_kwh + INSIDE_KWH
    inner = replace(
        instance,
        energy_min_kwh=least,
        end_energy_min_kwh=instance.end_energy_min_kwh + INSIDE_KWH,
        energy_max_kwh=instance.energy_max_kwh - INSIDE_KWH,
        stops=tuple(
            replace(
                s,
                arrive_min_kwh=s.arrive_min_kwh + INSIDE_KWH,
                leave_min_kwh=s.leave_min_kwh + INSIDE_KWH,
            )
            for s in instance.stops
        ),
    )
    moved, _ = complete(Simulation(inner), controls)
    trajectory = simulate(instance, moved)
    return trajectory if float(trajectory.violation.max()) <= STRICT else None


def attacked(z: Array, rng: Random) -> Iterator[tuple[str, Array]]:
    """Yield spoilt dual vectors, with their names.

    Parameters
    ----------
    z : ndarray, shape (m,)
        A solver's dual vector or ray.
    rng : Generator
        For the random ones.

    Examples
    --------
    >>> names = [name for name, _ in attacked(np.ones(4), np.random.default_rng(0))]
    >>> "permuted" in names and "not a number" in names
    True
    """
    size = float(np.abs(z[np.isfinite(z)]).max(initial=0.0)) or 1.0
    some = rng.random(z.size)
    yield "noise", z + rng.normal(size=z.size) * size * 10.0 ** rng.uniform(-9, 1)
    yield "scaled", z * 10.0 ** rng.uniform(-4, 4)
    yield "scaled row by row", z * np.exp(rng.normal(size=z.size))
    yield "huge", z * 1e80
    yield "tiny", z * 1e-180
    yield "negated", -z
    yield "signs flipped", np.where(some < 0.2, -z, z)
    yield "rows dropped", np.where(some < 0.3, 0.0, z)
    yield "permuted", rng.permutation(z)
    yield "shifted by one", np.roll(z, 1)
    yield "reversed", z[::-1].copy()
    yield "truncated", z[: z.size // 2]
    yield "too long", np.append(z, 1.0)
    yield "second half zero", np.where(np.arange(z.size) < z.size // 2, z, 0.0)
    yield "single precision", z.astype(np.float32).astype(np.float64)
    yield "half precision", np.clip(z, -6e4, 6e4).astype(np.float16).astype(np.float64)
    yield "rounded", np.round(z, 2)
    yield "one huge entry", np.where(np.arange(z.size) == int(some[0] * z.size), 1e12, z)
    yield "random", rng.normal(size=z.size) * size
    yield "ones", np.ones(z.size)
    for name, value in (("not a number", np.nan), ("infinite", np.inf)):
        spoilt = z.copy()
        spoilt[int(some[-1] * z.size)] = value
        yield name, spoilt


@dataclass
class Known:
    """What is known of a subset: its instance, its root bound and plans anybody found.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    lower_bound : float
        Root bound, ``inf`` if proved infeasible.
    strict : list of Trajectory
        Trajectories that keep every limit exactly.
    cost : float
        Least cost of any feasible plan, what it misses limits by paid for; ``inf`` without one.
    """

    instance: Instance
    lower_bound: float = -inf
    strict: list[Trajectory] = field(default_factory=list)
    cost: float = inf

    def add(self, trajectory: Trajectory, feasible: bool) -> None:
        """Note a plan."""
        if float(trajectory.violation.max()) <= STRICT:
            self.strict.append(trajectory)
        if feasible or float(trajectory.violation.max()) <= STRICT:
            self.cost = min(self.cost, merit(self.instance, trajectory))


def drive_at_random(known: Known, rng: Random, effort: Effort) -> None:
    """Add random drives that happen to be feasible."""
    simulation = Simulation(known.instance)
    for _ in range(effort.drives):
        controls = random_controls(known.instance, rng)
        if rng.random() < 0.7:
            controls, _ = complete(simulation, controls)
        trajectory = strictly_feasible(known.instance, controls)
        if trajectory is not None:
            known.add(trajectory, True)


def refine_at_random(known: Known, rng: Random, effort: Effort) -> None:
    """Add refined plans from random and from sensible starts."""
    instance = known.instance
    even = even_start(instance)
    starts = [even, *(random_controls(instance, rng) for _ in range(effort.starts))]
    if instance.stops:
        starts.append(warm_start(instance, even, float(rng.uniform(5.0, 35.0)), rng.random()))
    point = relax_subset(instance).point
    starts.append(best_start(instance, point, known.lower_bound))
    for start in starts:
        refined = refine(instance, start, RefineSettings(max_programs=25))
        known.add(refined.trajectory, refined.feasible)
        if refined.feasible:
            trajectory = strictly_feasible(instance, refined.controls)
            if trajectory is not None:
                known.add(trajectory, True)
