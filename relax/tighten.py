"""Owns which steps a proof takes on one box: what to bound, in which order, and where to cut.

Bounds the cost, then the stays, the energies charged and the temperatures, each over all
points of the relaxation that cost less than the cutoff, as long as that pays;
otherwise says how to cut the box. Choices live here, proofs in ``proof``.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count, pairwise

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.branch import Branch, Target, branch
from relax.cuts import at_stops, charges, next_cut, stays, undecided, wide_charge, widest
from relax.instance import Instance
from relax.intervals import Interval
from relax.proof import BoxProof, Closed, Step
from relax.reach import make_box
from relax.relaxed_point import Optimum, RelaxedPoint, unpack_point
from relax.solve import ConeSolver, SolveSettings, SolveStatus, solve_cone, solve_objective

__all__ = ["Proof", "Tightened", "prove", "tighten"]

Array = npt.NDArray[np.float64]
Worths = Mapping[str, tuple[float, float]]

SETTINGS = SolveSettings(tolerance=1e-4)
"""Bounds are safe whatever the tolerance; a looser one changes them by less than 0.01 %."""
WORTH = {"charge": (np.inf, 0.5), "stay": (np.inf, 0.05), "temperature": (np.inf, 3.0),
         "stop_temperature": (np.inf, 3.0)}  # fmt: skip
"""A lower or upper bound problem is solved if it can gain at least this [kWh, h, K]: a battery
that might be too warm loosens the heat pump and the charge limit, and one that might stay long
may get cold. Least charges follow from the largest of the other stops."""
FAMILY_WORTH = {"charge": (np.inf, 20.0), "stay": (np.inf, 0.5)}
"""The same for a family, whose programs are large and whose parts inherit what was gained."""
FAMILY_NEWS = 2
"""Stays bounded at least before the charges of a family are: with fewer, they mostly have been
for a family that it is a part of."""
FINE_WORTH = {"charge": (0.05, 0.05), "dwell": (np.inf, 0.003), "temperature": (1.0, 1.0),
              "stop_temperature": (1.0, 1.0)}  # fmt: skip
"""The same where little is missing: there every term counts [kWh, K, h]."""
FINE_SHARE = 0.006
"""Share of the cutoff that is missing at most where quantities are bounded finely."""
FINE_STEPS = 10
"""Every so many steps the temperature is bounded finely."""
PROGRESS = 0.5
"""Share of the distance to the cutoff that a round must gain for another one."""
SHORT_LEG = 4
"""Legs of up to this many steps get no temperature bound of their own."""


@dataclass(frozen=True)
class Tightened:
    """What became of one box.

    Parameters
    ----------
    closed : bool
        It holds no plan below the cutoff.
    bound : float
        No plan in it costs less [currency]; the cutoff if ``closed``.
    proved : float
        What relaxations alone bound, at most the cutoff [currency].
    box : Box
        What is left of it.
    how : Branch or None
        Where to cut it; None if it is closed or too small to cut.
    point : RelaxedPoint or None
        The last relaxed optimum of a fixed subset: where a refinement may start.
    used : ndarray, shape (S,)
        How far every stop is used at the last relaxed optimum, 1 for those not optional.
    steps : tuple of Step
        The proof.
    programs : int
        Cone programs solved.
    """

    closed: bool
    bound: float
    proved: float
    box: Box
    how: Branch | None
    point: RelaxedPoint | None
    used: Array
    steps: tuple[Step, ...]
    programs: int


class _Work:
    """A proof in the making: solves what the steps need."""

    def __init__(self, proof: BoxProof, deadline: float) -> None:
        self.proof, self.deadline = proof, deadline
        self.programs = 0
        self.x: Array = np.zeros(0)
        self._solver: ConeSolver | None = None

    @property
    def late(self) -> bool:
        return time.perf_counter() > self.deadline

    def relax(self) -> None:
        """Bound the cost on the box."""
        program = self.proof.build()
        found = solve_cone(program, SETTINGS)
        self.programs += 1
        self.x, self._solver = found.x, None
        ray = found.status is SolveStatus.INFEASIBLE
        self.proof.apply(Step("relax", found.z, ray), program)

    def adopt(self, known: Optimum) -> None:
        """Bound the cost on the box by an optimum that is known already."""
        self.x, self._solver = known.x, None
        self.proof.apply(Step("relax", known.z), known.program)

    def shrink(self, target: Target, worths: Worths = WORTH) -> None:
        """Bound one quantity, on the sides where the relaxed optimum leaves room."""
        proof = self.proof
        columns, index = proof.columns(target), target.index
        assert proof.program is not None
        here = float((self.x * proof.program.scale)[columns].sum())
        for sign, worth in zip((1, -1), worths[target.name], strict=True):
            interval: Interval = getattr(proof.box, target.name)
            end = float((interval.lo if sign > 0 else interval.hi)[index])
            if sign * (here - end) < worth or self.late:
                continue
            program = proof.objective(target, sign)
            self._solver = self._solver or ConeSolver(program, SETTINGS)
            found = solve_objective(self._solver, program.q)
            self.programs += 1
            ray = found.status is SolveStatus.INFEASIBLE
            proof.apply(Step("shrink", found.z, ray, target, sign), program)

    def spread(self) -> None:
        """Propagate what was learnt through the box."""
        for _ in range(2):
            self.proof.apply(Step("propagate"))

    def round(self, targets: list[Target], worths: Worths = WORTH) -> None:
        """Bound quantities; if any was worth it, propagate, and bound the cost again."""
        before = self.programs
        for target in targets:
            self.shrink(target, worths)
        if self.programs > before:
            self.spread()
            self.relax()

    def bound_family(self) -> None:
        """Bound stays and charges of a family's optional stops, unless most stays are known."""
        box, before = self.proof.box, self.programs
        for target in stays(box):
            self.shrink(target, FAMILY_WORTH)
        if self.programs >= before + FAMILY_NEWS:
            for target in charges(box):
                self.shrink(target, FAMILY_WORTH)
        if self.programs > before:
            self.spread()
            self.relax()


def _legs(instance: Instance) -> list[Target]:
    """Temperatures in the middle of every leg and at the end."""
    borders = [0, *(s.node for s in instance.stops if not s.optional), instance.drive.n_steps]
    nodes = [(a + b) // 2 for a, b in pairwise(borders) if b - a > SHORT_LEG]
    return [Target("temperature", k, "temperature") for k in [*nodes, borders[-1]]]


def _fine(instance: Instance) -> Iterator[list[Target]]:
    """Yield what is bounded where little is missing: stops, their cells, the way between them."""
    cells = instance.cells
    stops = range(len(instance.stops))
    thirds = [(i, j) for i in stops for j in {cells // 4, cells // 2, 3 * cells // 4}]
    yield [
        *(Target("charge", i, "charge") for i in stops),
        *at_stops(instance),
        *(Target("stop_temperature", at, "border") for at in thirds),
    ]
    yield [Target("dwell", (i, j), "dwell") for i in stops for j in range(cells)]
    nodes = range(FINE_STEPS, instance.drive.n_steps, FINE_STEPS)
    yield [Target("temperature", k, "temperature") for k in (*nodes, instance.drive.n_steps)]


def tighten(
    instance: Instance,
    box: Box,
    cutoff: float,
    *,
    bound: float = -np.inf,
    fresh: bool = False,
    whole: bool = True,
    deadline: float = np.inf,
    known: Optimum | None = None,
) -> Tightened:
    """Bound, shrink and if need be cut one box.

    Parameters
    ----------
    instance : Instance
        Fixed subset, or family of subsets, and grid.
    box : Box
        A valid box of it.
    cutoff : float
        Cost below which plans matter [currency].
    bound : float
        Lower bound known before [currency].
    fresh : bool
        The box comes from ``make_box``: intervals are propagated already.
    whole : bool
        No interval of it has been halved: then stays and charges are bounded before it is cut.
    deadline : float
        ``time.perf_counter()`` from which on no further program is begun [s].
    known : Optimum, optional
        That of the box's relaxation, if it has been solved.

    Returns
    -------
    Tightened
        Its bound holds whatever the solver did.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> done = tighten(instance, make_box(instance), cutoff=100.0)
    >>> done.closed, done.bound >= 100.0
    (True, True)
    """
    proof = BoxProof(instance, box, cutoff, bound)
    work = _Work(proof, deadline)
    closed, how = False, None
    try:
        proof.check()
        if not fresh:
            work.spread()
        if known is None:
            work.relax()
        else:
            work.adopt(known)
        how = _settle(work, whole)
    except Closed:
        closed = True
    used = np.where(proof.box.optional, 0.0, 1.0)
    point = None
    if not closed and proof.program is not None and np.isfinite(work.x).all():
        if proof.box.optional.any():
            used = np.where(proof.box.optional, proof.program.value("used", work.x), 1.0)
        elif instance.stops:
            point = unpack_point(proof.program, work.x)
    return Tightened(
        closed=closed,
        bound=cutoff if closed else proof.bound,
        proved=proof.bound,
        box=proof.box,
        how=how,
        point=point,
        used=used,
        steps=tuple(proof.steps),
        programs=work.programs,
    )


def _settle(work: _Work, whole: bool) -> Branch | None:
    """Shrink the box as long as that pays; return where to cut what is left.

    Stays and charges are bounded on the ``whole`` box; parts of it that are still wide are cut
    at once, which takes one program and often suffices.
    """
    proof = work.proof
    instance = proof.instance
    assert proof.program is not None
    if proof.box.optional.any():
        if np.isfinite(proof.cutoff):
            work.bound_family()
        used = np.where(proof.box.optional, proof.program.value("used", work.x), 1.0)
        return undecided(proof.box, used)
    if not whole and (wide := wide_charge(proof.box)):
        return wide
    while not work.late:
        before = proof.bound
        work.round(stays(proof.box))
        work.round(charges(proof.box))
        if wide := wide_charge(proof.box):
            return wide
        work.round(_legs(instance))
        work.round(at_stops(instance))
        if proof.bound - before < PROGRESS * (proof.cutoff - before):
            break
    while not work.late and (
        proof.cutoff - proof.bound < FINE_SHARE * abs(proof.cutoff)
        or widest(instance, proof.box) is None
    ):
        before = proof.bound
        for targets in _fine(instance):
            work.round(targets, FINE_WORTH)
        if proof.bound - before < PROGRESS * (proof.cutoff - before):
            break
    return next_cut(instance, proof.box, proof.program, work.x)


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
    """

    closed: bool
    lower_bound: float
    boxes: int
    programs: int


def prove(
    instance: Instance,
    cutoff: float,
    *,
    bound: float = -np.inf,
    max_boxes: int = 200,
    deadline: float = np.inf,
) -> Proof:
    """Try to prove that a fixed subset holds no plan cheaper than the cutoff.

    Parameters
    ----------
    instance : Instance
        Subset and grid; no optional stops.
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

    Raises
    ------
    ValueError
        The instance has optional stops.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (0, 1, 2))
    >>> prove(instance, cutoff=250.0).closed
    True
    """
    if instance.optional.any():
        raise ValueError("prove needs a fixed subset; tighten takes optional stops")
    ticket = count()
    queue: list[tuple[float, int, Box]] = [(bound, next(ticket), make_box(instance))]
    kept = np.inf
    boxes, programs = 0, 0
    while queue and boxes < max_boxes and time.perf_counter() < deadline:
        known, _, box = heapq.heappop(queue)
        done = tighten(
            instance, box, cutoff, bound=known, fresh=not boxes, whole=not boxes, deadline=deadline
        )
        boxes += 1
        programs += done.programs
        if done.closed:
            continue
        if done.how is None:
            kept = min(kept, done.bound)
            continue
        for part in branch(done.box, done.how):
            heapq.heappush(queue, (done.bound, next(ticket), part))
    lowest = min([cutoff, kept, *(entry[0] for entry in queue)])
    return Proof(
        closed=not queue and kept == np.inf,
        lower_bound=max(lowest, bound),
        boxes=boxes,
        programs=programs,
    )
