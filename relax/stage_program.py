"""Owns the cone program of one stage: its relaxation, what follows it, and what it may cost.

Rows are added for planes that bound the cost of all later stages from below, for a budget,
and for a start that may be left at a penalty. Only numbers change between solves, so the
solver's set-up is kept. Every claim is certified here from a dual vector alone, without
the rows of the start: it holds wherever in its cell the stage starts. Knows no solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from relax.box import Box
from relax.branch import Target
from relax.certify import Infeasible, LowerBound, certify_infeasible, certify_lower_bound
from relax.instance import Instance
from relax.program import ConeProgram
from relax.proof import OBJECTIVE_SIZE
from relax.relaxation import build_relaxation

__all__ = ["Penalty", "Plane", "StageProgram"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

SLOTS = 6
"""Planes that one program holds: the latest; with 3, a proof took a fifth more programs."""
COST_SCALE = 10.0
"""Size of the costs in rows [currency]."""
FREE = 1e5
"""Right-hand side of a budget that does not bind (scaled)."""
ABSENT = 1e-14
"""Stands for a coefficient of 0: the pattern of the matrix stays."""
EPS = 4.0 * float(np.finfo(np.float64).eps)
MOST_OFF = 10.0
"""Largest distance from the asked start (scaled)."""


class Plane(NamedTuple):
    """An affine lower bound of costs over the state: constant + energy * E + temperature * T."""

    constant: float
    energy: float
    temperature: float

    def at(self, state: tuple[float, float]) -> float:
        """Return its value."""
        return self.constant + self.energy * state[0] + self.temperature * state[1]


class Penalty(NamedTuple):
    """What it costs to leave the asked start [currency/kWh, currency/K]."""

    energy: float
    temperature: float


@dataclass(frozen=True)
class _Places:
    """Where in the matrix the numbers are that change."""

    start: int
    future: int
    budget: int
    keep: int
    planes: Index
    budget_start: Index


class StageProgram:
    """A stage's relaxation on a box with room for planes, a budget and a start.

    Parameters
    ----------
    instance : Instance
        A stage.
    box : Box
        A box of it, not empty.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> from relax.stage import START, make_stage
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> stage = make_stage(family, START, 1)
    >>> program = StageProgram(stage, make_box(stage))
    >>> program.set_planes([Plane(0.0, 0.0, 0.0)])
    >>> zero = np.zeros(program.cone.b.size)
    >>> bool(np.isfinite(program.claim_cost((0.0, 0.0), zero)))  # what the box alone says
    True
    """

    def __init__(self, instance: Instance, box: Box) -> None:
        self.box = box
        self.bare = build_relaxation(instance, box, lean=True)
        v, n = self.bare.variables, self.bare.q.size
        self.start = np.array([v["energy"][0], v["temperature"][0]])
        self.ends = bool(instance.stops)
        """Whether a stop follows, after which the trip goes on."""
        self.end = np.zeros(0, dtype=np.int64)
        if self.ends:
            self.end = np.array([v["leave"][-1], v["stop_temperature"][-1, -1]])
        self.off = np.arange(n, n + 3)
        self.at = self.bare.n_zero + self.bare.n_nonneg
        self._extend()

    def _extend(self) -> None:
        """Add columns for the distance from the start and for later costs, and their rows."""
        bare, at, n = self.bare, self.at, self.bare.q.size
        slots, future = (SLOTS, n + 3) if self.ends else (0, -1)
        width = n + 3 + (1 if self.ends else 0)
        entries: list[tuple[int, int, float]] = []
        (e, t), (over, warm, cold) = self.start.tolist(), self.off.tolist()
        # start: E - over <= e, T - warm <= t, -T - cold <= -t
        entries += [(0, e, 1.0), (0, over, -1.0), (1, t, 1.0), (1, warm, -1.0)]
        entries += [(2, t, -1.0), (2, cold, -1.0)]
        for k in range(slots):
            entries += [(3 + k, future, -1.0), *((3 + k, int(c), ABSENT) for c in self.end)]
        budget = 3 + slots
        priced = np.flatnonzero(bare.q)
        entries += [(budget, int(c), float(bare.q[c]) / COST_SCALE) for c in priced]
        entries += [(budget, int(c), ABSENT) for c in self.start if bare.q[c] == 0.0]
        if self.ends:
            entries.append((budget, future, 1.0))
        entries += [(budget + 1 + i, int(c), -1.0) for i, c in enumerate(self.off)]
        added = budget + 4
        row, column, value = (np.array(x) for x in zip(*entries, strict=True))
        old = bare.A.tocoo()
        below = old.row >= at
        m = bare.b.size + added
        A = sp.csc_array(
            sp.coo_array(
                (
                    np.concatenate([old.data, value.astype(np.float64)]),
                    (np.concatenate([old.row + added * below, row + at]),
                     np.concatenate([old.col, column])),
                ),
                shape=(m, width),
            )
        )  # fmt: skip
        A.sort_indices()
        self.q = np.concatenate([bare.q, np.zeros(width - n)])
        if self.ends:
            self.q[future] = COST_SCALE
        room = [0.0] if self.ends else []
        self.cone: ConeProgram = replace(
            bare,
            q=self.q,
            A=A,
            b=np.concatenate([bare.b[:at], np.zeros(added), bare.b[at:]]),
            n_nonneg=bare.n_nonneg + added,
            l=np.concatenate([bare.l, np.zeros(3), room]),
            u=np.concatenate([bare.u, np.full(3, MOST_OFF), room]),
            scale=np.concatenate([bare.scale, np.ones(3), [COST_SCALE] if self.ends else []]),
            row_scale=np.insert(bare.row_scale, [at] * added, 1.0),
            rows=MappingProxyType({k: r + added * (r >= at) for k, r in bare.rows.items()}),
        )
        places = [[_place(A, at + 3 + k, int(c)) for c in self.end] for k in range(slots)]
        self._places = _Places(
            start=at,
            future=at + 3,
            budget=at + budget,
            keep=at + added,
            planes=np.array(places, dtype=np.int64).reshape(slots, self.end.size),
            budget_start=np.array([_place(A, at + budget, int(c)) for c in self.start]),
        )

    def set_planes(self, planes: Sequence[Plane]) -> None:
        """Let later stages cost at least the latest planes; the last stage takes none."""
        if not self.ends:
            return
        latest = [*planes[-SLOTS:]]
        latest += latest[:1] * (SLOTS - len(latest))
        cone, scale = self.cone, self.bare.scale[self.end]
        values = np.array(latest)
        slope = values[:, 1:] * scale / COST_SCALE
        cone.A.data[self._places.planes] = np.where(slope == 0.0, ABSENT, slope)
        first = self._places.future
        reach = self._reach(self.end)
        spare = (np.abs(slope) * EPS + ABSENT) @ reach + EPS * np.abs(values[:, 0]) / COST_SCALE
        cone.b[first : first + SLOTS] = spare - values[:, 0] / COST_SCALE
        lo, hi = self.bare.l[self.end], self.bare.u[self.end]
        ends = slope * lo, slope * hi
        base = values[:, 0] / COST_SCALE
        cone.l[-1] = float((base + np.minimum(*ends).sum(axis=1)).max()) - 1.0
        cone.u[-1] = float((base + np.maximum(*ends).sum(axis=1)).max()) + 1.0

    def ask_start(self, state: tuple[float, float], penalty: Penalty) -> Array:
        """Ask for a start, which may be left at a penalty; return the objective."""
        p, scale = self._places, self.bare.scale[self.start]
        energy, temperature = np.array(state) / scale
        self.cone.b[p.start : p.start + 3] = energy, temperature, -temperature
        q = self.q.copy()
        q[self.off] = (
            np.array([penalty.energy, penalty.temperature, penalty.temperature])
            * (scale[[0, 1, 1]])
        )
        self._free_budget()
        return q

    def ask_slope(self, slope: tuple[float, float]) -> Array:
        """Ask for the least cost less a value of the start's state; return the objective."""
        self._free_start()
        self._free_budget()
        return self._off(self._cost_less(slope))

    def ask_quantity(self, target: Target, sign: int, budget: Plane) -> Array:
        """Ask for the end of a quantity within a budget, a plane over the start's state."""
        self._free_start()
        self._set_budget(budget)
        return self._off(self._quantity(target, sign))

    def slope_at(self, z: Array) -> tuple[float, float]:
        """Return the slopes that a dual vector gives to the asked start."""
        over, warm, cold = z[self._places.start : self._places.start + 3]
        scale = self.bare.scale[self.start]
        return float(-over / scale[0]), float((cold - warm) / scale[1])

    def end_state(self, x: Array) -> tuple[float, float]:
        """Return the state with which the car drives on."""
        energy, temperature = x[self.end] * self.bare.scale[self.end]
        return float(energy), float(temperature)

    def claim_cost(self, slope: tuple[float, float], z: Array) -> float:
        """Certify the constant of a plane below the cost of this and all later stages.

        Parameters
        ----------
        slope : tuple of float
            Its slopes over energy and temperature.
        z : ndarray, shape (m,)
            Any dual vector.

        Returns
        -------
        float
            ``-inf`` if nothing is proved.
        """
        program = replace(self.cone, q=self._cost_less(slope))
        safe = certify_lower_bound(program, self._claimed(z, within=False))
        return safe.value if isinstance(safe, LowerBound) else -np.inf

    def claim_empty(self, z: Array, budget: Plane | None = None) -> bool:
        """Certify that the stage has no point, or none within a budget."""
        if budget is not None:
            self._set_budget(budget)
        ray = self._claimed(z, within=budget is not None)
        return isinstance(certify_infeasible(self.cone, ray), Infeasible)

    def claim_quantity(self, target: Target, sign: int, budget: Plane, z: Array) -> float:
        """Certify a lower bound of sign * quantity within a budget; ``-inf`` without proof."""
        if not np.isfinite(budget.constant):  # no plan and no bound yet: nothing to rest on
            return -np.inf
        self._set_budget(budget)
        program = replace(self.cone, q=self._quantity(target, sign), constant=0.0)
        safe = certify_lower_bound(program, self._claimed(z, within=True))
        value = safe.value / OBJECTIVE_SIZE if isinstance(safe, LowerBound) else -np.inf
        return float(np.nextafter(value, -np.inf))

    def _claimed(self, z: Array, within: bool) -> Array:
        """Return the dual vector without the rows of the asked start, and of no budget."""
        if z.shape != self.cone.b.shape:
            return z
        p = self._places
        out = z.copy()
        out[p.start : p.start + 3] = 0.0
        out[p.budget + (1 if within else 0) : p.keep] = 0.0
        return out

    def _cost_less(self, slope: tuple[float, float]) -> Array:
        q = self.q.copy()
        q[self.start] -= np.array(slope) * self.bare.scale[self.start]
        return q

    def _quantity(self, target: Target, sign: int) -> Array:
        q = np.zeros_like(self.q)
        columns = np.atleast_1d(self.bare.variables[target.variable][target.index]).ravel()
        q[columns] = sign * OBJECTIVE_SIZE * self.bare.scale[columns]
        return q

    def _off(self, q: Array) -> Array:
        """Return the objective with a price on being off the start, so that it stays bounded."""
        q = q.copy()
        q[self.off] = 1.0
        return q

    def _free_start(self) -> None:
        start, u, l = self._places.start, self.bare.u[self.start], self.bare.l[self.start]  # noqa: E741
        self.cone.b[start : start + 3] = u[0] + 1.0, u[1] + 1.0, 1.0 - l[1]

    def _free_budget(self) -> None:
        self.cone.b[self._places.budget] = FREE
        self.cone.A.data[self._places.budget_start] = self._start_prices()

    def _set_budget(self, budget: Plane) -> None:
        """Cost of this and later stages at most a plane over the start's state."""
        scale = self.bare.scale[self.start] / COST_SCALE
        slope = np.array([budget.energy, budget.temperature]) * scale
        # the slopes are rounded, and 0 is not: what that changes is added to the budget
        spare = float((np.abs(slope) * EPS + ABSENT) @ self._reach(self.start))
        sizes = np.abs(self.bare.q) @ np.maximum(np.abs(self.bare.l), np.abs(self.bare.u))
        sizes += abs(budget.constant) + abs(self.bare.constant)
        spare += EPS * float(sizes) / COST_SCALE
        own = (budget.constant - self.bare.constant) / COST_SCALE
        prices = self._start_prices() - slope
        self.cone.A.data[self._places.budget_start] = np.where(prices == 0.0, ABSENT, prices)
        self.cone.b[self._places.budget] = own + spare

    def _reach(self, columns: Index) -> Array:
        return np.maximum(np.abs(self.bare.l[columns]), np.abs(self.bare.u[columns]))

    def _start_prices(self) -> Array:
        prices = self.bare.q[self.start] / COST_SCALE
        return np.where(prices == 0.0, ABSENT, prices)


def _place(A: sp.csc_array, row: int, column: int) -> int:
    """Return where an entry is in the data of a matrix."""
    first, last = A.indptr[column], A.indptr[column + 1]
    return int(first + np.searchsorted(A.indices[first:last], row))
