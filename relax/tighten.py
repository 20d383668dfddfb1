"""Owns the proof that a fixed subset holds no plan cheaper than a cutoff: tighten, branch, close.

A box is shrunk by bound problems (least and largest value of a quantity among
all points of the relaxation that cost less than the cutoff) and by
reachability; where that stalls, it is split. Every bound is a safe one, every
closed box a theorem. Knows nothing of other subsets.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.certify import Infeasible, LowerBound, certify_infeasible, certify_lower_bound
from relax.instance import Instance
from relax.intervals import Interval
from relax.program import ConeProgram, add_cutoff
from relax.reach import make_box, propagate
from relax.relaxation import build_relaxation
from relax.solve import SolveSettings, SolveStatus, solve_cone

__all__ = ["Proof", "prove"]

Array = npt.NDArray[np.float64]

SETTINGS = SolveSettings(tolerance=1e-3)
"""Bounds are safe whatever the tolerance; a looser one changes them by less than 0.01 %."""
WORTH = {
    "charge": (0.5, 0.5),
    "stay": (0.1, 0.05),
    "temperature": (8.0, 2.0),
    "stop_temperature": (8.0, 2.0),
}
"""A lower or upper bound problem is solved if it can gain at least this [kWh, h, K]: a battery
that might be too warm loosens the heat pump and the charge limit, a cold one little."""
LEAST_SPLIT = {"charge": 0.5, "stay": 0.02, "temperature": 1.0, "stop_temperature": 1.0}
"""Intervals narrower than this are not split [kWh, h, K]."""
SPLIT_UNIT = {"charge": 3.0, "stay": 0.15, "temperature": 8.0, "stop_temperature": 8.0}
"""Widths that count alike when the quantity to split is chosen [kWh, h, K]."""
PROGRESS = 0.25
"""Share of the distance to the cutoff that a round must gain for another one."""
LEG_SHARES = (0.5, 0.25, 0.75)
"""Where between two stops the temperature is bounded, as shares of the steps."""


@dataclass(frozen=True)
class Proof:
    """What was proved of a fixed subset.

    Parameters
    ----------
    closed : bool
        No plan of the subset costs less than the cutoff.
    lower_bound : float
        No plan costs less than this; at least the cutoff if ``closed`` [currency].
    boxes : int
        Boxes looked at.
    programs : int
        Cone programs solved.
    solve_s, build_s : float
        Time inside the solver, and for boxes, rows and certificates [s].
    """

    closed: bool
    lower_bound: float
    boxes: int
    programs: int
    solve_s: float
    build_s: float


class _Closed(Exception):  # noqa: N818
    """The box holds no plan below the cutoff."""


@dataclass(frozen=True)
class _Target:
    """A quantity to bound: an entry of the box and the variables that add up to it."""

    name: str
    variable: str
    index: int | tuple[int, int]


def _targets(instance: Instance, stage: int) -> Iterator[_Target]:
    """Quantities in order of value: energy charged, time, temperatures at stops, between stops."""
    stops, cells = instance.stops, instance.cells
    if stage == 0:
        for i in range(len(stops)):
            yield _Target("charge", "charge", i)
        for i in range(len(stops)):
            yield _Target("stay", "dwell", i)
    elif stage == 1:
        for i, stop in enumerate(stops):
            yield _Target("temperature", "temperature", stop.node)
            yield _Target("stop_temperature", "border", (i, cells))
            yield _Target("stop_temperature", "border", (i, cells // 2))
    else:
        borders = [0, *(s.node for s in stops), instance.drive.n_steps]
        for share in LEG_SHARES:
            for a, b in pairwise(borders):
                if b - a > 4:
                    yield _Target("temperature", "temperature", a + int(share * (b - a)))


def _with(box: Box, name: str, interval: Interval) -> Box:
    """Return the box with another interval."""
    changes: dict[str, Any] = {name: interval}
    return replace(box, **changes)


class _Work:
    """One box being tightened: its programs, its relaxed optimum, its bound."""

    def __init__(self, instance: Instance, box: Box, cutoff: float, bound: float) -> None:
        self.instance, self.box, self.cutoff, self.bound = instance, box, cutoff, bound
        self.programs, self.solve_s = 0, 0.0
        self.x: Array = np.zeros(0)
        self.program: ConeProgram | None = None

    def solve(self, program: ConeProgram) -> tuple[float, Array]:
        """Return the safe bound of a program and its relaxed optimum; closes if infeasible."""
        found = solve_cone(program, SETTINGS)
        self.programs += 1
        self.solve_s += found.solve_s
        if found.status is SolveStatus.INFEASIBLE and isinstance(
            certify_infeasible(program, found.z), Infeasible
        ):
            raise _Closed
        safe = certify_lower_bound(program, found.z)
        return safe.value if isinstance(safe, LowerBound) else -np.inf, found.x

    def relax(self) -> None:
        """Bound the cost on the box."""
        if self.box.empty:
            raise _Closed
        program = build_relaxation(self.instance, self.box)
        bound, self.x = self.solve(program)
        self.bound = max(self.bound, bound)
        if self.bound >= self.cutoff:
            raise _Closed
        self.program = add_cutoff(program, self.cutoff)

    def shrink(self, target: _Target) -> None:
        """Bound one quantity from both sides, where the relaxed optimum leaves room."""
        program = self.program
        assert program is not None
        columns = np.atleast_1d(program.variables[target.variable][target.index]).ravel()
        here = float((self.x * program.scale)[columns].sum())
        interval: Interval = getattr(self.box, target.name)
        for sign, worth in zip((1.0, -1.0), WORTH[target.name], strict=True):
            end = float((interval.lo if sign > 0.0 else interval.hi)[target.index])
            if sign * (here - end) < worth:
                continue
            q = np.zeros_like(program.q)
            q[columns] = sign * program.scale[columns]
            value, _ = self.solve(replace(program, q=q, constant=0.0))
            if value <= sign * end:
                continue
            lo, hi = interval.lo.copy(), interval.hi.copy()
            (lo if sign > 0.0 else hi)[target.index] = sign * value
            interval = Interval(lo, hi)
        self.box = _with(self.box, target.name, interval)

    def spread(self) -> None:
        """Propagate what was learnt through the box."""
        for _ in range(2):
            if self.box.empty:
                raise _Closed
            self.box = propagate(self.instance, self.box)

    def tighten(self) -> None:
        """Shrink the box as long as that pays; raises ``_Closed`` when nothing is left."""
        self.relax()
        while True:
            before = self.bound
            for stage in range(3):
                for target in _targets(self.instance, stage):
                    self.shrink(target)
                self.spread()
                self.relax()
            if self.bound - before < PROGRESS * (self.cutoff - before):
                return


def _split(instance: Instance, box: Box) -> tuple[Box, Box] | None:
    """Cut the box in two along the quantity that is widest for its kind; None if all are narrow."""
    best, choice = 0.0, None
    for stage in (0, 1):
        for target in _targets(instance, stage):
            interval: Interval = getattr(box, target.name)
            lo, hi = float(interval.lo[target.index]), float(interval.hi[target.index])
            width = hi - lo
            if width > LEAST_SPLIT[target.name] and width / SPLIT_UNIT[target.name] > best:
                best, choice = width / SPLIT_UNIT[target.name], (target, 0.5 * (lo + hi))
    if choice is None:
        return None
    target, at = choice
    halves = []
    for upper in (False, True):
        whole: Interval = getattr(box, target.name)
        ends = whole.lo.copy(), whole.hi.copy()
        ends[0 if upper else 1][target.index] = at
        halves.append(_with(box, target.name, Interval(*ends)))
    return halves[0], halves[1]


def prove(
    instance: Instance,
    cutoff: float,
    *,
    bound: float = -np.inf,
    max_boxes: int = 200,
    deadline: float = np.inf,
) -> Proof:
    """Try to prove that a subset holds no plan cheaper than the cutoff.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    cutoff : float
        Cost below which plans matter [currency].
    bound : float
        Lower bound known before [currency].
    max_boxes : int
        Boxes to look at before giving up.
    deadline : float
        ``time.perf_counter()`` at which to give up [s].

    Returns
    -------
    Proof
        ``lower_bound`` holds in any case: boxes not closed keep theirs.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (0, 1, 2))
    >>> prove(instance, cutoff=250.0).closed
    True
    """
    begin = time.perf_counter()
    ticket = count()
    box = make_box(instance)
    queue: list[tuple[float, int, Box]] = [(bound, next(ticket), box)]
    done = np.inf
    boxes, programs, solve_s = 0, 0, 0.0
    while queue and boxes < max_boxes and time.perf_counter() < deadline:
        known, _, box = heapq.heappop(queue)
        work = _Work(instance, box, cutoff, known)
        boxes += 1
        try:
            for _ in range(2 if boxes > 1 else 0):
                work.box = propagate(instance, work.box)
                if work.box.empty:
                    raise _Closed
            work.tighten()
            halves = _split(instance, work.box)
            if halves is None:
                done = min(done, work.bound)
            for half in halves or ():
                heapq.heappush(queue, (work.bound, next(ticket), half))
        except _Closed:
            pass
        programs, solve_s = programs + work.programs, solve_s + work.solve_s
    lowest = min([cutoff, done, *(entry[0] for entry in queue)])
    seconds = time.perf_counter() - begin
    return Proof(
        closed=not queue and done == np.inf,
        lower_bound=max(lowest, bound),
        boxes=boxes,
        programs=programs,
        solve_s=solve_s,
        build_s=seconds - solve_s,
    )
